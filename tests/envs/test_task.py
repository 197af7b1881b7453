"""What is rewarded and when it is over, against what missions are judged by."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from uwirl import build
from uwirl.envs import RelayEnv, RelayTask, make_task
from uwirl.motion.cost import CostWeights
from uwirl.study.evaluation import Evaluation, Evaluator
from uwirl.world.agent import Feedback
from uwirl.world.navigation import Navigation
from uwirl.world.random import RandomStreams

# Past the edge of the first obstacle of Fig. 5, which it touches for some steps of the world.
AIM = np.array([0.2, 0.0, 0.017, 0.0], dtype=np.float32)
GRAZING = ["scenario.start=[[26,24,-5,-2.124]]", "scenario.duration_s=10", "channel.zeta_dB=0"]
DRIFTING = ["scenario.obstacles=[{center_m:[24,22],radius_m:2,influence_m:6,velocity_mps:[0.1,-0.2]}]"]
PAIR = ["experiment=fig6_pair", "scenario.duration_s=10", "channel.zeta_dB=0"]


def flown(env: RelayEnv, action: np.ndarray) -> tuple[list[float], dict]:
    """Rewards of an episode with an action held, and its last info."""
    env.reset(seed=0)
    rewards, over, info = [], False, {}
    while not over:
        _, reward, terminated, truncated, info = env.step(action)
        rewards.append(reward)
        over = terminated or truncated
    return rewards, info


def judged(task: RelayTask, action: np.ndarray) -> Evaluation:
    """The same flight by uwirl's own evaluator."""
    judge = task.worlds(RandomStreams.worlds(0, 1))
    tau = torch.tensor(action).double().view(1, -1, 4) * judge.env.vehicle.tau_max
    return judge.fly(Feedback(lambda observation: tau))


@pytest.mark.parametrize(
    ("overrides", "action"),
    [(GRAZING, AIM), ([*GRAZING, *DRIFTING], AIM), (PAIR, np.tile(AIM, 2))],
    ids=["grazing", "drifting", "pair"],
)
def test_rewards_add_up_to_what_missions_are_judged_by(overrides: list[str], action: np.ndarray):
    env = RelayEnv(overrides=overrides, control_period_s=0.05)
    rewards, info = flown(env, action)
    evaluation = judged(env.task, action)
    assert len(rewards) == env.task.scenario.steps
    assert -sum(rewards) == pytest.approx(float(evaluation.cost), rel=1e-12)
    assert info["J"] == pytest.approx(float(evaluation.cost), rel=1e-12)
    assert info["chain_capacity_kbps"] == pytest.approx(float(evaluation.chain_capacity[-1]), rel=1e-12)


@pytest.mark.parametrize("drift", [[], DRIFTING], ids=["standing", "drifting"])
def test_contacts_between_steps_of_control_are_counted(drift: list[str]):
    env = RelayEnv(overrides=[*GRAZING, *drift], control_period_s=2.0)
    _, info = flown(env, AIM)
    metrics = judged(env.task, AIM).metrics()
    assert info["contacts"] == metrics["collisions"] > 0
    assert info["clearance_m"] == pytest.approx(metrics["min_obstacle_clearance_m"], abs=1e-12)


def test_the_integral_converges_with_the_control_period():
    J = {
        period: -sum(flown(RelayEnv(overrides=GRAZING, control_period_s=period), AIM)[0]) for period in (0.05, 0.5, 1.0)
    }
    coarse, fine = abs(J[1.0] - J[0.05]), abs(J[0.5] - J[0.05])
    assert fine < 1e-3 * J[0.05]
    assert coarse > 3.0 * fine


def test_each_vehicle_is_rewarded_for_its_own_place():
    task = make_task(PAIR)
    judge = task.worlds(RandomStreams.worlds(0, 1))
    # The first vehicle at its target, the second where it starts.
    settled = task.begin(judge)
    components = settled.world.components.clone()
    components[:3, 0, 0] = task.features.frame.target[0]
    components[3, 0, 0] = task.features.frame.bearing[0]
    at_rest = (judge.env.vehicle.trim / judge.env.vehicle.tau_max).expand(1, 2, 4)
    state = settled._replace(world=settled.world._replace(components=components), stage=settled.stage * 0.0)
    _, outcome = task.step(judge, state, at_rest)
    assert float(outcome.reward[0, 0]) == pytest.approx(0.0, abs=1e-12)
    assert float(outcome.reward[0, 1]) < -1e-3


def test_the_guard_keeps_off_what_the_bare_action_hits():
    bare, touched = flown(RelayEnv(overrides=GRAZING, ends_on_contact=True), AIM)
    guarded, kept = flown(RelayEnv(overrides=GRAZING, ends_on_contact=True, guard="energy"), AIM)
    assert touched["contacts"] == 1
    assert len(bare) < len(guarded) == 20
    assert kept["contacts"] == 0
    assert kept["clearance_m"] > 0.0


def test_an_episode_ends_by_contact_in_the_step_that_touches():
    env = RelayEnv(overrides=GRAZING, ends_on_contact=True)
    env.reset(seed=0)
    for _ in range(20):
        _, _, terminated, truncated, info = env.step(AIM)
        assert terminated == (info["contacts"] > 0)
        if terminated:
            break
    assert not truncated


def test_vehicles_that_touch_end_the_episode():
    start = "scenario.start=[[5,0,-5,3.1416],[-5,0,-5,0]]"
    ahead = np.array([0.5, 0.0, 0.017, 0.0] * 2, dtype=np.float32)
    _, info = flown(RelayEnv(overrides=[*PAIR, start], ends_on_contact=True, control_period_s=0.1), ahead)
    assert info["contacts"] == 2
    assert -0.3 < info["clearance_m"] < 0.0


def test_noise_of_navigation_is_observed_and_not_rewarded():
    config_task = make_task(GRAZING)
    env = config_task.evaluator.env
    noisy_env = env.on(replace(env.scenario, navigation=Navigation(position_m=1.0, yaw_rad=0.1)), env.streams)
    noisy = RelayEnv(RelayTask(Evaluator(noisy_env, config_task.evaluator.mission.weights)))
    exact = RelayEnv(config_task)
    (seen, _), (true, _) = noisy.reset(seed=0), exact.reset(seed=0)
    assert np.abs(seen - true)[:5].min() > 1e-4
    np.testing.assert_array_equal(seen[-2:], true[-2:])
    assert noisy.step(AIM)[1] == exact.step(AIM)[1]


def test_no_way_to_the_target_is_told():
    ring = [
        f"{{center_m:[{4 * np.cos(a):.4f},{4 * np.sin(a):.4f}],radius_m:1.5,influence_m:3}}"
        for a in np.linspace(0.0, 2.0 * np.pi, 10, endpoint=False)
    ]
    closed, open_ = ([f"scenario.obstacles=[{','.join(ring[:n])}]"] for n in (10, 7))
    assert RelayEnv(overrides=closed).reset(seed=0)[1]["blocked"] is True
    assert RelayEnv(overrides=open_).reset(seed=0)[1]["blocked"] is False


def test_an_episode_is_a_whole_number_of_steps_of_control():
    task = make_task([*GRAZING, "scenario.duration_s=1.2"], control_period_s=0.5)
    rewards, _ = flown(RelayEnv(task), AIM)
    assert len(rewards) == task.steps == 3


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"control_period_s": 0.07}, "control_period_s: must be a multiple of dt, 0.05 s, got 0.07"),
        ({"control_period_s": 0.0}, "control_period_s: must be a multiple"),
        ({"nearest_obstacles": -1}, "nearest_obstacles: must not be negative, got -1"),
    ],
)
def test_bad_options_are_refused(options: dict, message: str):
    with pytest.raises(ValueError, match=message):
        make_task(GRAZING, **options)


def test_worlds_that_differ_are_refused(make_config):
    env = build.make_relay(make_config())
    apart = env.on(replace(env.scenario, start=env.scenario.start.expand(2, 1, 4)), RandomStreams.worlds(0, 2))
    with pytest.raises(ValueError, match="share start, obstacles and mean current"):
        RelayTask(Evaluator(apart, CostWeights()))


def test_dynamics_that_diverge_are_an_error():
    task = make_task(GRAZING)
    judge = task.worlds(RandomStreams.worlds(0, 2))
    state = task.begin(judge)
    components = state.world.components.clone()
    components[4, 1] = 1e300
    broken = state._replace(world=state.world._replace(components=components))
    with pytest.raises(FloatingPointError, match="diverged in world 1"):
        task.step(judge, broken, torch.zeros(2, 1, 4, dtype=torch.float64))
