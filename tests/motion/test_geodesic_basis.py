"""The basis of the way: its policies are those of the guidance, and flights teach it the pace."""

import math

import pytest
import torch
from uwirl.motion.policy import LinkFramePolicy

from uwirl import build
from uwirl.irl.networks import LinearActor
from uwirl.motion.geodesic_basis import WayState
from uwirl.motion.targets import mean_channel_targets
from uwirl.snr.estimators import oracle
from uwirl.world.messages import take_readings
from uwirl.world.vehicle import VehicleState

OVERRIDES = ("experiment=fig5_single", "basis=geodesic", "experience=parallel")


@pytest.fixture
def made(make_config, make_relay):
    """made(overrides...): configuration, environment, planner, targets and cost on the true channel."""

    def make(*overrides: str):
        config, env = make_config(*OVERRIDES, *overrides), make_relay(*OVERRIDES, *overrides)
        targets = mean_channel_targets(env.scenario, env.channel)
        cost = build.make_cost(config.cost, env.channel, targets, env.vehicle.tau_max)
        return config, env, build.make_planner(config, config.planner, env), targets, cost

    return make


def states(count: int) -> VehicleState:
    """On the way between Fig. 5's obstacles, near the goal and off the way, at speed and turning."""
    random = torch.Generator().manual_seed(0)
    share = torch.rand(count, 1, 1, generator=random, dtype=torch.float64)
    eta = torch.cat([29.0 * share, 29.0 * share + 3.0, -8.0 * (1.0 - share), 6.0 * share - 3.0], -1)
    return VehicleState.from_eta_nu(eta, 0.5 * torch.randn(count, 1, 4, generator=random, dtype=torch.float64))


def test_policies_of_the_basis_are_those_of_the_guidance(made, make_config):
    """With the theory's k and the guidance's damping and heading hold, and the same link-frame weights."""
    _, env, planner, targets, cost = made()
    basis = planner.make_basis(cost)
    near = basis.near.start_weights()
    settings = make_config("guidance=geodesic").guidance
    hold = near.split(basis.near_sizes)[3]
    # The guidance adds its hold to the led policy's yaw, the basis has one of its own.
    heading = (float(hold[0]) - settings.heading_stiffness, float(hold[1]) - settings.heading_damping)
    weights = basis.weights(near, (settings.gain, -settings.lateral_damping), 1.0, heading)
    trim = env.vehicle.trim.double()
    own = planner.guidance(env, cost, targets)(LinkFramePolicy(targets.frame, LinearActor(basis, weights[None]), trim))
    theory = build.make_guidance(make_config("experiment=fig5_single"))(env, cost, targets)
    led = theory(LinkFramePolicy(targets.frame, LinearActor(basis.near, near[None]), trim))
    state = states(40)
    torch.testing.assert_close(own(state, 0), led(state, 0), rtol=0, atol=1e-9)


def test_start_lies_within_the_bounds(made):
    _, _, planner, _, cost = made()
    basis = planner.make_basis(cost)
    start, bounds = basis.start_weights(), basis.bounds((12.0, 12.0, 12.0, 0.2), 0.05)
    assert ((start >= bounds.lower) & (start <= bounds.upper)).all()
    assert len(start) == sum(len(names) for names in basis.actor_names)


def test_features_of_a_batch_are_those_of_its_singles(made):
    _, env, planner, targets, cost = made()
    basis = planner.make_basis(cost)
    state = states(5)
    together = basis.observer(env, targets.frame)(state, 0)
    for k in range(5):
        one = VehicleState(state.components[:, k : k + 1].contiguous())
        alone = basis.observer(env, targets.frame)(one, 0)
        torch.testing.assert_close(alone[0], together[k], rtol=0, atol=1e-12)
        torch.testing.assert_close(basis.actor(alone)[0], basis.actor(together)[k], rtol=0, atol=1e-9)
    seen = WayState.of(together)
    torch.testing.assert_close(torch.linalg.vector_norm(seen.way, dim=-1), torch.ones(5, 1).double())
    assert (seen.q >= 0.0).all()


def test_flights_among_obstacles_teach_the_pace(made):
    """From k = 1, best against linear drag, towards 0.577, best against quadratic drag; nobody touches anything."""
    _, env, planner, _, _ = made("experience.worlds=20", "planner.max_time_s=1700")
    truth = oracle(take_readings(env), env.channel)
    records = list(planner.iterate(env, truth))
    names = planner.basis.actor_names[0]
    k = float(records[-1].actor[0, names.index("F_along")])
    assert float(planner.start_weights[0, names.index("F_along")]) == 1.0
    assert 0.3 < k < 0.85
    assert planner.recorder.contacts == 0
    assert math.isfinite(float(records[-1].critic.sum()))
