"""The single and the parallel environment: what they are made from, their errors, pictures and random starts."""

from __future__ import annotations

import runpy
from pathlib import Path

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.error import ResetNeeded

from uwirl import build
from uwirl.config.checks import ConfigError
from uwirl.envs import RelayEnv, RelayParallelEnv, make_task
from uwirl.envs.starts import random_starts
from uwirl.motion.safety import EnergyGuard
from uwirl.world.layouts import SEPARATION_M, START_CLEARANCE_M
from uwirl.world.random import RandomStreams

PAIR = ["experiment=fig6_pair", "channel.zeta_dB=0", "scenario.duration_s=1"]
STILL = np.zeros(4, dtype=np.float32)


@pytest.fixture
def single() -> RelayEnv:
    return RelayEnv(overrides=[*PAIR, "experiment=fig5_single"], render_mode="rgb_array")


@pytest.fixture
def parallel() -> RelayParallelEnv:
    return RelayParallelEnv(overrides=PAIR, render_mode="rgb_array")


def both(action: np.ndarray) -> dict[str, np.ndarray]:
    return {"vehicle_0": action, "vehicle_1": action}


def test_a_step_before_reset_or_after_the_end_is_refused(single: RelayEnv, parallel: RelayParallelEnv):
    for env, action in ((single, STILL), (parallel, both(STILL))):
        for ready in (False, True):
            if ready:
                env.reset(seed=0)
                env.step(action)
                env.step(action)
            with pytest.raises(ResetNeeded, match=r"no episode is under way: call reset\(\) before step\(\)"):
                env.step(action)
    assert parallel.agents == []
    with pytest.raises(ResetNeeded, match="nothing has begun"):
        RelayParallelEnv(overrides=PAIR).state()


@pytest.mark.parametrize(
    ("action", "got"), [(np.zeros(3, np.float32), "shape"), (np.zeros(4, int), "int64"), (np.full(4, np.nan), "nan")]
)
def test_what_is_no_action_is_refused(single: RelayEnv, parallel: RelayParallelEnv, action: np.ndarray, got: str):
    single.reset(seed=0)
    parallel.reset(seed=0)
    with pytest.raises(ValueError, match=rf"floating-point array of shape \(4,\) .*{got}"):
        single.step(action)
    with pytest.raises(ValueError, match=rf"vehicle_1: the action must be a floating-point array .*{got}"):
        parallel.step({"vehicle_0": STILL, "vehicle_1": action})


@pytest.mark.parametrize("actions", [{}, {"vehicle_0": STILL}, {**both(STILL), "vehicle_2": STILL}])
def test_actions_of_other_vehicles_are_refused(parallel: RelayParallelEnv, actions: dict):
    parallel.reset(seed=0)
    with pytest.raises(ValueError, match=r"actions are needed of vehicle_0, vehicle_1, got"):
        parallel.step(actions)


def test_both_faces_fly_the_same_world(parallel: RelayParallelEnv):
    single = RelayEnv(parallel.task)
    seen, _ = single.reset(seed=4)
    observations, _ = parallel.reset(seed=4)
    np.testing.assert_array_equal(np.concatenate(list(observations.values())), seen)
    actions = {"vehicle_0": STILL + np.float32(0.2), "vehicle_1": STILL - np.float32(0.1)}
    seen, reward, *_, info = single.step(np.concatenate(list(actions.values())))
    observations, rewards, _, _, infos = parallel.step(actions)
    np.testing.assert_array_equal(np.concatenate(list(observations.values())), seen)
    np.testing.assert_array_equal(parallel.state(), seen)
    assert sum(rewards.values()) == pytest.approx(reward, rel=1e-12)
    assert sum(each["J"] for each in infos.values()) == pytest.approx(info["J"], rel=1e-12)
    assert infos["vehicle_1"]["chain_capacity_kbps"] == info["chain_capacity_kbps"]


def test_overrides_are_those_of_the_command_line():
    env = gymnasium.make("uwirl.envs:uwirl/Relay-v0", overrides=["channel=acoustic_24khz", "scenario.duration_s=3"])
    channel = env.unwrapped.task.evaluator.truth.channel
    assert (channel.n, channel.zeta_dB, env.unwrapped.task.steps) == (2.0, 3.0, 6)
    with pytest.raises(ConfigError, match=r"did you mean 'channel.zeta_dB'"):
        RelayEnv(overrides=["channel.zeta=3"])
    with pytest.raises(ConfigError, match=r"scenario.duration_s"):
        RelayEnv(overrides=["scenario.duration_s=-1"])
    with pytest.raises(ConfigError, match=r"scenario.layouts"):
        RelayEnv(overrides=["experiment=random_layouts"])


def test_the_guard_is_none_an_option_or_ones_own():
    def own(tau: torch.Tensor, observation: object) -> torch.Tensor:
        return 0.0 * tau

    env = RelayEnv(overrides=PAIR)
    tau = torch.full((1, 2, 4), 1e6)
    observation = env.task.evaluator.env.reset()[1]
    assert env.task.evaluator.guard(tau, observation) is tau
    assert isinstance(make_task([*PAIR, "safety.margin_m=0.4"], guard="energy").evaluator.guard, EnergyGuard)
    assert make_task(PAIR, guard=own).evaluator.guard is own
    # Nothing but buoyancy moves a vehicle whose guard stops all thrusters.
    stopped = RelayEnv(overrides=PAIR, guard=own)
    for each in (env, stopped):
        each.reset(seed=0)
    idle, _ = env.step(np.zeros(8, dtype=np.float32))[:2]
    np.testing.assert_array_equal(stopped.step(np.ones(8, dtype=np.float32))[0], idle)
    with pytest.raises(ConfigError, match="safety"):
        make_task(PAIR, guard="energetic")


def test_a_task_of_ones_own_needs_no_configuration_and_takes_no_options():
    task = make_task(PAIR)
    assert RelayEnv(task).task is task
    with pytest.raises(TypeError, match="a task is made already; guard would have no effect"):
        RelayEnv(task, guard="energy")


def test_the_seed_of_an_environment_without_one_is_drawn_once():
    env = RelayEnv(overrides=PAIR, random_start=True)
    first, second = env.reset()[0], env.reset()[0]
    other = RelayEnv(overrides=PAIR, random_start=True).reset()[0]
    assert not np.array_equal(first, second)
    assert not np.array_equal(first, other)


def test_pictures_show_where_vehicles_went(single: RelayEnv, parallel: RelayParallelEnv):
    for env, action in ((single, STILL + np.float32(0.5)), (parallel, both(STILL + np.float32(0.5)))):
        env.reset(seed=0)
        start = env.render()
        env.step(action)
        moved = env.render()
        assert (moved.dtype, moved.shape) == (np.uint8, (480, 480, 3))
        assert not np.array_equal(start, moved)
        env.reset(seed=0)
        np.testing.assert_array_equal(env.render(), start)
    assert RelayEnv(single.task).render() is None
    with pytest.raises(ValueError, match="render_mode: expected None or rgb_array, got 'human'"):
        RelayEnv(single.task, render_mode="human")


def test_random_starts_are_a_worlds_own_and_have_room(make_config):
    around = "[{center_m:[0,0],radius_m:8,influence_m:12},{center_m:[15,15],radius_m:5,influence_m:9}]"
    config = make_config("experiment=fig6_pair", f"scenario.obstacles={around}")
    scenario = build.make_scenario(config)
    targets = torch.tensor([[-10.0, -10.0, -8.0], [10.0, 10.0, -8.0]], dtype=torch.float64)
    streams = RandomStreams.worlds(5, 2000)
    start = random_starts(scenario, targets, streams)
    assert float(scenario.clearance(start[..., :3]).min()) >= START_CLEARANCE_M
    assert float(torch.linalg.vector_norm(start[:, 0, :3] - start[:, 1, :3], dim=-1).min()) >= SEPARATION_M
    some = torch.tensor([3, 1999, 40])
    torch.testing.assert_close(random_starts(scenario, targets, streams.select(some)), start[some], rtol=0.0, atol=0.0)
    # Uniform over a square of half width 30 m, of which the obstacles take a share that lies about its centre.
    low, high = start.flatten(0, 1).amin(0), start.flatten(0, 1).amax(0)
    torch.testing.assert_close(high, torch.tensor([30.0, 30.0, -0.5, torch.pi]).double(), rtol=0.0, atol=0.2)
    torch.testing.assert_close(low, torch.tensor([-30.0, -30.0, -16.0, -torch.pi]).double(), rtol=0.0, atol=0.2)
    free = build.make_scenario(make_config("experiment=fig6_pair"))
    variance = random_starts(free, targets, streams).flatten(0, 1).var(0)
    width = torch.tensor([60.0, 60.0, 15.5, 2.0 * torch.pi]).double()
    torch.testing.assert_close(variance, width**2 / 12.0, rtol=0.08, atol=0.0)


def test_water_without_room_is_an_error(make_config):
    config = make_config("scenario.obstacles=[{center_m:[0,0],radius_m:60,influence_m:80}]")
    with pytest.raises(RuntimeError, match="no start clear of obstacles and other vehicles"):
        random_starts(build.make_scenario(config), torch.zeros(1, 3).double(), RandomStreams.worlds(0, 2))


@pytest.mark.slow
def test_the_example_trains():
    pytest.importorskip("stable_baselines3")
    example = Path(__file__).parents[2] / "examples" / "train_sb3.py"
    before, after = runpy.run_path(str(example))["main"](300)
    assert np.isfinite([before, after]).all()
    assert before != after
