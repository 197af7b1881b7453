"""The basis of the way: its agents are those of the guidance, and flights teach it the pace."""

import math

import pytest
import torch

from uwirl import build
from uwirl.irl.networks import LinearActor
from uwirl.motion.geodesic_basis import GeodesicBasis
from uwirl.motion.learning import Learning
from uwirl.motion.linear_agent import LinkController
from uwirl.motion.route_view import WayState
from uwirl.snr.estimators import oracle
from uwirl.world.readings import take_readings
from uwirl.world.trajectory import WorldState
from uwirl.world.truth import truth_of
from uwirl.world.vehicle import VehicleState

OVERRIDES = ("experiment=fig5_single", "basis=geodesic", "experience=parallel")


@pytest.fixture
def learning(make_config, make_relay):
    """learning(overrides...): on the true channel."""

    def make(*overrides: str) -> Learning:
        config, env = make_config(*OVERRIDES, *overrides), make_relay(*OVERRIDES, *overrides)
        truth = oracle(take_readings(env), env.budget, truth_of(env).channel)
        return Learning(build.make_planner(config, config.planner, env), env, truth)

    return make


@pytest.fixture
def basis(learning) -> GeodesicBasis:
    return learning().basis


def states(count: int) -> WorldState:
    """On the way between Fig. 5's obstacles, near the goal and off the way, at speed and turning."""
    random = torch.Generator().manual_seed(0)
    share = torch.rand(count, 1, 1, generator=random, dtype=torch.float64)
    eta = torch.cat([29.0 * share, 29.0 * share + 3.0, -8.0 * (1.0 - share), 6.0 * share - 3.0], -1)
    nu = 0.5 * torch.randn(count, 1, 4, generator=random, dtype=torch.float64)
    return WorldState.of(VehicleState.from_eta_nu(eta, nu))


def test_agents_of_the_basis_are_those_of_the_guidance(learning, basis, make_config):
    """With the theory's k and the guidance's damping and heading hold, and the same link-frame weights."""
    problem = learning()
    mission, frame = problem.mission, problem.mission.targets.frame
    near = basis.near.start_weights()
    theory = build.make_guidance(make_config("experiment=fig5_single"))
    hold = near.split(basis.near_sizes)[3]
    # The guidance adds its hold to the led controller's yaw, the basis has one of its own.
    heading = (float(hold[0]) - theory.heading_stiffness, float(hold[1]) - theory.heading_damping)
    weights = basis.weights(near, (theory.gain, -theory.lateral_damping), 1.0, heading)
    trim = mission.env.vehicle.trim.double()
    own = problem.agent(weights[None], trim)
    led = theory(mission)(LinkController(frame, LinearActor(basis.near, near[None]), trim))
    observation = mission.env.observe(states(40))
    found, expected = (agent.act(agent.init(observation), observation)[0] for agent in (own, led))
    torch.testing.assert_close(found, expected, rtol=0, atol=1e-9)


def test_start_lies_within_the_bounds(basis):
    start, bounds = basis.start_weights(), basis.bounds((12.0, 12.0, 12.0, 0.2), 0.05)
    assert ((start >= bounds.lower) & (start <= bounds.upper)).all()
    assert len(start) == sum(len(names) for names in basis.actor_names)


def test_features_of_a_batch_are_those_of_its_singles(learning, basis):
    mission = learning().mission
    view, env, state = basis.view(mission.env, mission.targets.frame), mission.env, states(5)

    def seen(components: torch.Tensor) -> torch.Tensor:
        observation = env.observe(WorldState.of(VehicleState(components)))
        return view.see(view.init(observation), observation)[0]

    together = seen(state.components)
    for k in range(5):
        alone = seen(state.components[:, k : k + 1].contiguous())
        torch.testing.assert_close(alone[0], together[k], rtol=0, atol=1e-12)
        torch.testing.assert_close(basis.actor(alone)[0], basis.actor(together)[k], rtol=0, atol=1e-9)
    x = WayState.of(together)
    torch.testing.assert_close(torch.linalg.vector_norm(x.way, dim=-1), torch.ones(5, 1).double())
    assert (x.q >= 0.0).all()


def test_flights_among_obstacles_teach_the_pace(learning):
    """From k = 1, best against linear drag, towards 0.577, best against quadratic drag; nobody touches anything."""
    problem = learning("experience.worlds=20", "planner.max_time_s=1700")
    state = problem.init()
    while not problem.is_over(state):
        leg, state = problem.fly(state)
        state = problem.improve(state, leg)
    column = problem.basis.actor_names[0].index("F_along")
    assert float(state.start[0, column]) == 1.0
    assert 0.3 < float(state.learner.actor[0, column]) < 0.85
    assert state.contacts == 0
    assert math.isfinite(float(state.learner.critic.sum()))
