"""Learning in flight: what the planners promise, briefly."""

import math

import pytest
import torch

from uwirl import build
from uwirl.irl.networks import LinearActor
from uwirl.irl.policy_iteration import InadmissiblePolicyError, InsufficientDataError
from uwirl.irl.solvers import BatchLeastSquares, ZRecursiveLeastSquares
from uwirl.motion.calibration import calibration_hover
from uwirl.motion.cost import CostWeights
from uwirl.motion.excitation import Excitation, PoseDraw
from uwirl.motion.features import LinkFrameBasis
from uwirl.motion.learning import Learning
from uwirl.motion.safety import Unguarded
from uwirl.snr.estimators import estimate_each_vehicle
from uwirl.study.evaluation import Evaluator
from uwirl.world.random import RandomStreams

SHORT = ("planner.max_time_s=45", "planner.tolerance_weights=0")


@pytest.fixture
def judge():
    """J of actor weights [K, n3] from the scenario's start on the true channel."""

    def costs(learned, weights):
        evaluator, start = Evaluator(learned.env, CostWeights()), learned.env.scenario.start[None]
        return evaluator.cost_of_weights(
            learned.learning, weights[:, None], learned.state.trim, learned.state.known, start
        )[:, 0]

    return costs


def test_forty_five_seconds_of_flight_halve_the_cost(learn, judge):
    """From three tenths of the start policy's gains; the optimum is 3.147."""
    learned = learn(*SHORT, "planner.start_gain=0.3")
    before, after = judge(learned, torch.cat([learned.state.start, learned.state.learner.actor])).tolist()
    assert before > 7.5
    assert 3.1 < after < 4.0


def test_seeds_in_one_batch_learn_as_they_do_alone(learn):
    """Counter-based draws and batched learners: seed 3 in a batch is seed 3 alone."""
    together = learn(*SHORT, "estimator=oracle", seeds=[1, 3, 8])
    alone = learn(*SHORT, "estimator=oracle", seeds=[3])
    torch.testing.assert_close(together.records[3].actor[1], alone.records[3].actor[0], rtol=1e-6, atol=1e-6)


def test_trim_is_learned_from_the_hover(make_config, make_relay):
    """B - W = 2 N pushes up; the planner was not told."""
    config, env = make_config("experiment=fig5_free"), make_relay("experiment=fig5_free")
    _, estimate = estimate_each_vehicle(env, build.make_estimator(config.estimator, env))
    state = Learning(build.make_planner(config, config.planner, env), env, estimate).init()
    assert float(state.trim[0, 2]) == pytest.approx(float(env.vehicle.trim[2]), abs=0.1)


def test_munk_moment_is_identified(learn):
    """The optimal yaw control cancels (m_v - m_u) u v = 7.2 u v, which nobody told the learner (median of seeds)."""
    learned = learn("planner.max_time_s=120", "planner.tolerance_weights=0", seeds=range(5))
    assert float(learned.state.learner.actor[:, -1].median()) == pytest.approx(24.2 - 17.0, rel=0.25)


def test_z_rls_equals_batch_least_squares_in_flight(make_config, make_relay):
    """On the rows of a real flight, with bounds, ridge, prior and relabelled windows."""
    overrides = ("experiment=fig5_free", *SHORT)
    config, env = make_config(*overrides), make_relay(*overrides)
    _, estimate = estimate_each_vehicle(env, build.make_estimator(config.estimator, env))
    learning = Learning(build.make_planner(config, config.planner, env), env, estimate)
    state = learning.init()
    recursive = learning.iteration.solver
    assert isinstance(recursive, ZRecursiveLeastSquares)
    batch = BatchLeastSquares(recursive.operator, recursive.bounds, recursive.ridge, recursive.prior)
    rows = batch.init(state.start)
    while not learning.is_over(state):
        leg, state = learning.fly(state)
        rows, state = batch.add(rows, leg.batch), learning.improve(state, leg)
    assert leg.batch.groups[1] is not None
    for weights in (state.learner.actor, 0.5 * state.start):
        found, expected = recursive.solve(state.learner.solver, weights)[0], batch.solve(rows, weights)[0]
        torch.testing.assert_close(found.actor, expected.actor, rtol=1e-9, atol=1e-9)


def test_parallel_worlds_teach_one_learner(learn, judge):
    learned = learn("experience=parallel", "experience.worlds=20", "planner.max_time_s=800")
    assert learned.state.learner.actor.shape == (1, 17)
    assert learned.records[0].seconds == 14.0 + 20 * 20.0
    assert float(judge(learned, learned.state.learner.actor)[0]) < 3.6


def test_one_set_of_weights_or_one_for_each_vehicle(learn):
    pair = ("scenario.start=[[29.5,29.5,0,1],[30.5,28.5,0,2]]",)
    own = learn(*SHORT, *pair).state.learner.actor
    assert own.shape == (2, 17)
    assert not torch.equal(own[0], own[1])
    shared = ("experience=parallel", "experience.worlds=5", "planner.max_time_s=200")
    one = learn(*shared, *pair)
    assert one.state.learner.actor.shape == (1, 17)
    agent = one.learning.agent(one.state.learner.actor, one.state.trim)
    _, observation = one.env.reset()
    assert agent.act(agent.init(observation), observation)[0].shape == (1, 2, 4)


def test_the_weights_of_one_vehicle_lead_any_number(learn, make_mission):
    """In other worlds each vehicle makes for its own target there."""
    one = learn("planner.max_time_s=20")
    three = make_mission("scenario.start=[[29.5,29.5,0,1],[25,20,-3,2],[10,0,-5,0]]")
    agent = one.learning.agent(one.state.learner.actor, one.state.trim, three.env)
    _, observation = three.env.reset()
    torch.testing.assert_close(agent.init(observation).target, three.targets.frame.target[None], rtol=0, atol=1e-9)
    assert agent.act(agent.init(observation), observation)[0].shape == (1, 3, 4)


VERTICAL = ("scenario.source_m=[0,0,-2]", "scenario.destination_m=[0,0,-18]", "scenario.start=[[15,10,-10,0]]")


@pytest.mark.parametrize("gain", [0.0, -1.0])
@pytest.mark.parametrize("link", [(), VERTICAL])
def test_inadmissible_start_is_refused(learn, gain, link):
    with pytest.raises(InadmissiblePolicyError, match="not admissible"):
        learn(*SHORT, *link, f"planner.start_gain={gain}")


@pytest.mark.parametrize("nodes", [(-2, -18), (-1000, -10)])
@pytest.mark.parametrize("start", [0, -10])
@pytest.mark.parametrize("weight", [90.0, 112.8, 140.0])
def test_any_net_weight_is_held_on_a_vertical_link(make_mission, nodes, start, weight):
    """Off the axis of a link the cost is flat: there an error of the depth by buoyancy would look like a bad policy."""
    source, destination = (
        f"scenario.{end}_m=[0,0,{z}]" for end, z in zip(("source", "destination"), nodes, strict=True)
    )
    water = f"scenario.depth_m={max(20, -min(nodes))}"
    mission = make_mission(
        source, destination, water, f"scenario.start=[[15,10,{start},0]]", f"vehicle.weight_N={weight}"
    )
    basis = LinkFrameBasis(mission.cost)
    actor = LinearActor(basis, basis.start_weights()[None])
    _, trim = calibration_hover(mission.env, actor, mission.cost, 14.0, Unguarded())
    assert float(trim[0, 2]) == pytest.approx(weight - 114.8, abs=0.7)


def test_too_short_a_flight_is_refused(learn):
    with pytest.raises(InsufficientDataError, match="19 rows of experience for 36 unknown weights"):
        learn("planner.max_time_s=15", "experience.relabel=0")


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
    assert learn(*overrides).state.contacts == 0
    assert learn(*overrides, "safety=none").state.contacts > 0


def test_its_flight_identifies_the_vehicle(make_config, make_relay):
    words = ("experiment=fig5_single", "planner.max_time_s=34", "planner.model_time_s=34")
    config, env = make_config(*words), make_relay(*words)
    _, estimate = estimate_each_vehicle(env, build.make_estimator(config.estimator, env))
    found = {}
    for doubt in (0.1, 1e-9):
        config.planner.most_doubt = doubt
        learning = Learning(build.make_planner(config, config.planner, env), env, estimate)
        state = learning.init()
        assert len(state.logs) == 1
        while not learning.is_over(state):
            state = learning.step(state)
        found[doubt] = state
    known = found[0.1].known
    assert known.theta[:4].tolist() == pytest.approx(env.vehicle.inertia.tolist(), rel=0.01)
    assert found[0.1].logs == ()
    # In doubt, nothing is taken as known, and the log is kept.
    assert found[1e-9].known is None
    assert len(found[1e-9].logs) == 5
    assert [record.modelled for record in learning.records(found[0.1])] == [True] * config.planner.updates
