"""Learning in flight: what the planners promise, briefly."""

import math

import pytest
import torch

from uwirl import build
from uwirl.irl.policy_iteration import InadmissiblePolicyError, InsufficientDataError
from uwirl.irl.solvers import BatchLeastSquares, ZRecursiveLeastSquares
from uwirl.motion.excitation import Excitation, PoseDraw
from uwirl.motion.planner import LearningPlanner
from uwirl.motion.targets import mean_channel_targets
from uwirl.snr.estimators import estimate_each_vehicle, oracle
from uwirl.study.evaluation import cost_of_weights, evaluate
from uwirl.world.messages import take_readings
from uwirl.world.random import RandomStreams

SHORT = ("planner.max_time_s=45", "planner.tolerance_weights=0")


@pytest.fixture
def learn(make_config, make_relay):
    """Learn with a configuration; returns environment, planner and records."""

    def run(*overrides: str, seeds=None):
        overrides = ("experiment=fig5_free", *overrides)
        config = make_config(*overrides)
        env = make_relay(*overrides, streams=RandomStreams.replicates(seeds) if seeds else None)
        _, estimate = estimate_each_vehicle(env, build.make_estimator(config.estimator))
        planner = build.make_planner(config, config.planner, env)
        assert isinstance(planner, LearningPlanner)
        return env, planner, list(planner.iterate(env, estimate))

    return run


@pytest.fixture
def judge(make_config):
    """J of actor weights [K, n3] from the scenario's start on the true channel."""

    def costs(env, planner, weights):
        targets = mean_channel_targets(env.scenario, env.channel)
        cost = build.make_cost(make_config().cost, env.channel, targets, env.vehicle.tau_max)
        return cost_of_weights(env, planner.policy, weights[:, None], cost, targets, env.scenario.start[None])[:, 0]

    return costs


def test_forty_five_seconds_of_flight_halve_the_cost(learn, judge):
    """From three tenths of the start policy's gains; the optimum is 3.147."""
    env, planner, records = learn(*SHORT, "planner.start_gain=0.3")
    before, after = judge(env, planner, torch.cat([planner.start_weights, records[-1].actor])).tolist()
    assert before > 7.5
    assert 3.1 < after < 4.0


def test_seeds_in_one_batch_learn_as_they_do_alone(learn):
    """Counter-based draws and batched learners: seed 3 in a batch is seed 3 alone."""
    _, _, together = learn(*SHORT, "estimator=oracle", seeds=[1, 3, 8])
    _, _, alone = learn(*SHORT, "estimator=oracle", seeds=[3])
    torch.testing.assert_close(together[3].actor[1], alone[3].actor[0], rtol=1e-6, atol=1e-6)


def test_same_seed_is_bitwise_the_same(learn):
    first, second = (learn(*SHORT)[2][-1] for _ in range(2))
    assert torch.equal(first.actor, second.actor)
    assert torch.equal(first.critic, second.critic)


def test_trim_is_learned_from_the_hover(learn):
    """B - W = 2 N pushes up; the planner was not told."""
    env, planner, _ = learn(*SHORT)
    assert float(planner.policy.trim[0, 2]) == pytest.approx(float(env.vehicle.trim[2]), abs=0.1)


def test_munk_moment_is_identified(learn):
    """The optimal yaw control cancels (m_v - m_u) u v = 7.2 u v, which nobody told the learner (median of seeds)."""
    overrides = ("planner.max_time_s=120", "planner.tolerance_weights=0")
    _, _, records = learn(*overrides, seeds=range(5))
    assert float(records[-1].actor[:, -1].median()) == pytest.approx(24.2 - 17.0, rel=0.25)


def test_z_rls_equals_batch_least_squares_in_flight(learn, monkeypatch):
    """On the rows of a real flight, with bounds, ridge, prior and relabelled windows."""
    solvers = []
    original = ZRecursiveLeastSquares.__init__

    def both(self, operator, regularisation, bounds=None):
        original(self, operator, regularisation, bounds)
        solvers.append((self, BatchLeastSquares(operator, regularisation, bounds)))

    add = ZRecursiveLeastSquares.add
    monkeypatch.setattr(ZRecursiveLeastSquares, "__init__", both)
    monkeypatch.setattr(ZRecursiveLeastSquares, "add", lambda self, e: (add(self, e), solvers[0][1].add(e))[0])
    _, _, records = learn(*SHORT)
    recursive, batch = solvers[0]
    for weights in (records[-1].actor, 0.5 * records[0].actor):
        found, expected = recursive.solve(weights), batch.solve(weights)
        torch.testing.assert_close(found.actor, expected.actor, rtol=1e-9, atol=1e-9)


def test_parallel_worlds_teach_one_learner(learn, judge):
    env, planner, records = learn("experience=parallel", "experience.worlds=20", "planner.max_time_s=800")
    assert records[-1].actor.shape == (1, 17)
    assert records[0].seconds == 14.0 + 20 * 20.0
    assert float(judge(env, planner, records[-1].actor)[0]) < 3.6


def test_one_set_of_weights_or_one_for_each_vehicle(learn):
    pair = ("scenario.start=[[29.5,29.5,0,1],[30.5,28.5,0,2]]",)
    env, own, _ = learn(*SHORT, *pair)
    assert own.policy.actor.weight.shape == (2, 17)
    assert not torch.equal(own.policy.actor.weight[0], own.policy.actor.weight[1])
    shared = ("experience=parallel", "experience.worlds=5", "planner.max_time_s=200")
    _, one, _ = learn(*shared, *pair)
    assert one.policy.actor.weight.shape == (1, 17)
    assert one.lead(one.policy)(env.reset(), 0).shape == (1, 2, 4)


@pytest.mark.parametrize("gain", [0.0, -1.0])
def test_inadmissible_start_is_refused(learn, gain):
    with pytest.raises(InadmissiblePolicyError, match="not admissible"):
        learn(*SHORT, f"planner.start_gain={gain}")


def test_too_short_a_flight_is_refused(learn):
    with pytest.raises(InsufficientDataError, match="19 rows of experience for 36 unknown weights"):
        learn("planner.max_time_s=15", "experience.relabel=0")


def test_pd_flies_to_the_target(make_config, make_relay):
    config, env = make_config("planner=pd"), make_relay("planner=pd")
    truth = oracle(take_readings(env), env.channel)
    policy = build.make_planner(config, config.planner, env).fit(env, truth)
    targets = mean_channel_targets(env.scenario, env.channel)
    cost = build.make_cost(config.cost, env.channel, targets, env.vehicle.tau_max)
    evaluation = evaluate(env, policy, cost, targets, env.reset())
    assert float(evaluation.chain_capacity[-1, 0]) > 0.99 * evaluation.optimal_capacity


def test_excitation_has_its_power_and_band():
    excitation = Excitation((36.0, 36.0, 18.0, 3.0), (1.0, 1.0), (0.2, 4.2))
    wave = excitation.draw(RandomStreams.worlds(0, 200), vehicles=1, leg=0, steps=4000, dt=0.05)
    torch.testing.assert_close(
        wave.square().mean((0, 1)).sqrt(), torch.tensor(excitation.rms, dtype=torch.float64), rtol=0.02, atol=0
    )
    power = torch.fft.rfft(wave, dim=0).abs().square().mean((1, 2))
    omega = 2.0 * math.pi * torch.fft.rfftfreq(4000, 0.05)
    inside = (omega > 0.1) & (omega < 4.4)
    assert float(power[inside].sum() / power.sum()) > 0.99


def test_poses_fill_their_box():
    draw = PoseDraw(44.0, 17.6, 8.0, 2.0, near_share=0.2, near_scale=0.15)
    pose = draw.draw(RandomStreams.worlds(0, 20_000), 1, 0)
    half = torch.tensor([44.0, 17.6, 8.0, 2.0], dtype=torch.float64)
    assert (pose.abs() <= half).all()
    assert (pose.abs().amax(0) > 0.99 * half).all()
    # A fifth of the legs, plus those of the rest that happen to be close by.
    near = (pose[:, 0].abs() < 0.15 * 44.0) & (pose[:, 1].abs() < 0.15 * 17.6)
    assert float(near.double().mean()) == pytest.approx(0.2 + 0.8 * 0.15**2, abs=0.01)


def test_learning_in_a_ring_of_obstacles_touches_none(learn):
    """Eight cylinders around the start: the guard holds while learning, and without it the vehicle runs into them."""
    ring = [(29.5 + 6.0 * math.cos(k * math.pi / 4), 29.5 + 6.0 * math.sin(k * math.pi / 4)) for k in range(8)]
    cylinders = ",".join(f"{{center_m:[{x},{y}],radius_m:1,influence_m:5}}" for x, y in ring)
    overrides = (*SHORT, f"scenario.obstacles=[{cylinders}]")
    _, guarded, _ = learn(*overrides)
    _, reckless, _ = learn(*overrides, "safety=none")
    assert guarded.recorder.contacts == 0
    assert reckless.recorder.contacts > 0
