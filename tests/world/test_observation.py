"""What vehicles perceive: obstacles within range, contact, what the others tell; and nothing else of the world."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from uwirl.world.agent import Feedback
from uwirl.world.navigation import Navigation
from uwirl.world.observation import Observation
from uwirl.world.obstacles import Obstacles
from uwirl.world.relay import Relay
from uwirl.world.trajectory import WorldState
from uwirl.world.vehicle import VehicleState

WORLDS = 5
START = [[-12.0, -9.0, -7.0, 0.5], [10.0, 11.0, -6.0, -1.0]]
# Of a vehicle.
RADIUS = 0.3


def tensor(values: list) -> Tensor:
    return torch.tensor(values, dtype=torch.float64)


def cylinders(centre: list, radius: list, velocity: list | None = None) -> Obstacles:
    rho = tensor(radius)
    still = torch.zeros_like(tensor(centre)) if velocity is None else tensor(velocity)
    return Obstacles(tensor(centre), rho, rho + 4.0, still, torch.ones_like(rho, dtype=torch.bool))


def identical(a: object, b: object) -> None:
    torch.testing.assert_close(a, b, rtol=0.0, atol=0.0, equal_nan=True)


def leaves(value: object) -> list[object]:
    return [leaf for part in value for leaf in leaves(part)] if isinstance(value, tuple) else [value]


# By the first vehicle, by the second, and in the middle.
NEAR_EACH = cylinders([[-12.0, -6.0], [13.0, 11.0], [0.0, 0.0]], [1.0, 1.5, 2.0], [[0.1, 0.0], [0.0, 0.0], [0.0, -0.2]])


def test_what_is_out_of_range_leaves_no_trace(make_pair):
    observed = make_pair(obstacles=NEAR_EACH, detection_range=5.0).reset()[1].obstacles
    expected = [[True, False, False], [False, True, False]]
    assert observed.present.tolist() == [expected] * WORLDS
    for field, known in zip(observed, NEAR_EACH, strict=True):
        hidden = ~observed.present
        assert not bool(field[hidden].any())
        assert torch.equal(field[observed.present], known[[0, 1] * WORLDS])


@pytest.mark.parametrize(
    "other",
    [
        cylinders([[-12.0, -6.0], [13.0, 11.0], [1.0, 2.0]], [1.0, 1.5, 2.5], [[0.1, 0.0], [0.0, 0.0], [0.3, 0.3]]),
        NEAR_EACH._replace(present=torch.tensor([True, True, False])),
    ],
    ids=["elsewhere", "absent"],
)
def test_what_a_hidden_obstacle_is_makes_no_difference(make_pair, other: Obstacles):
    env = make_pair(obstacles=NEAR_EACH, detection_range=5.0)
    changed = env.on(replace(env.scenario, obstacles=other), env.streams)
    identical(changed.reset()[1], env.reset()[1])
    # Where the map is known it does.
    known = [e.on(replace(e.scenario, detection_range=torch.inf), e.streams).reset()[1] for e in (env, changed)]
    assert any(not torch.equal(a, b) for a, b in zip(*(o.obstacles for o in known), strict=True))


@pytest.mark.parametrize(("gap", "detected"), [(5.0 - 1e-9, True), (5.0 + 1e-9, False)])
def test_range_is_from_hull_to_hull(make_pair, gap: float, detected: bool):
    """Definition 1, horizontally: depth does not hide a cylinder."""
    beside = START[0][1] + gap + 2.0 + RADIUS
    env = make_pair(obstacles=cylinders([[START[0][0], beside]], [2.0]), detection_range=5.0)
    assert env.reset()[1].obstacles.present[:, 0].tolist() == [[detected]] * WORLDS


def test_an_obstacle_is_detected_when_it_comes(make_pair):
    """At 1 m/s from 10 m beyond the range: after 10 s, which are 200 steps. Its axis is told where it was at time 0."""
    y = START[0][1] + 10.0 + 5.0 + 2.0 + RADIUS
    comes = cylinders([[START[0][0], y]], [2.0], [[0.0, -1.0]])
    env = make_pair(obstacles=comes, detection_range=5.0)
    rest = env.start()
    seen = [env.observe(rest._replace(step=rest.step + step)) for step in (0, 199, 201)]
    assert [o.obstacles.present[:, 0, 0].tolist() for o in seen] == [[False] * 5, [False] * 5, [True] * 5]
    assert seen[2].obstacles.centre[0, 0].tolist() == [[START[0][0], y]]
    # The clearance that the vehicle works out from it is the true one.
    last = seen[2]
    gap = last.obstacles.clearance(last.position[..., None, :], RADIUS, last.time[:, None])[:, 0, 0, 0]
    torch.testing.assert_close(gap, torch.full_like(gap, 5.0 - 0.05), rtol=0.0, atol=1e-9)


def test_a_known_map_is_known_to_all(make_pair):
    """In worlds with obstacles of their own, each sees its own, absent ones included."""
    own = NEAR_EACH.each(lambda field: torch.stack([field] * WORLDS))
    own.centre[:, 2] += torch.arange(5.0)[:, None]
    own.present[3, 1] = False
    observed = make_pair(obstacles=own).reset()[1].obstacles
    for field, known in zip(observed, own, strict=True):
        assert torch.equal(field, known[:, None].expand_as(field))
    shared = make_pair(obstacles=NEAR_EACH).reset()[1].obstacles
    assert shared.centre.shape == (WORLDS, 2, 3, 2)
    assert torch.equal(shared.centre, NEAR_EACH.centre.expand(WORLDS, 2, 3, 2))


def test_free_water_has_no_obstacles(make_pair):
    observed = make_pair("scenario.obstacles=[]", detection_range=5.0).reset()[1].obstacles
    assert observed.number == 0
    assert observed.radius.shape == (WORLDS, 2, 0)


def test_an_observation_is_nothing_but_numbers(make_pair):
    """No channel, scenario or environment hangs on it, by which an agent could come to know the truth."""
    observation = make_pair(obstacles=NEAR_EACH, streaming=True).reset()[1]
    numbers = [leaf for leaf in leaves(observation) if not isinstance(leaf, Tensor)]
    assert numbers == [observation.dt]
    assert all(len(leaf) == WORLDS for leaf in leaves(observation) if isinstance(leaf, Tensor))


def test_the_channel_is_not_perceived(make_pair):
    """But through readings: without these, any channel looks the same."""
    two = [make_pair(f"channel={name}", "channel.zeta_dB=2") for name in ("paper", "acoustic_24khz")]
    identical(two[0].reset()[1], two[1].reset()[1])
    listening = [env.on(replace(env.scenario, streaming=True), env.streams).reset()[1] for env in two]
    assert not torch.equal(*(o.messages.snr for o in listening))
    identical(*(o._replace(messages=o.messages[:3]) for o in listening))


@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_contact_with_surface_and_floor(make_pair, dtype: str):
    env = make_pair(f"dtype={dtype}", depth=12.3)
    z = torch.tensor([[0.0, -12.3], [-0.001, -12.299], [-6.0, 0.0], [-12.3, -12.3], [-1.0, -2.0]])
    eta = env.start().vehicles.eta.clone()
    eta[..., 2] = z
    observation = env.observe(WorldState.of(VehicleState.from_eta_nu(eta)))
    assert observation.contact.tolist() == [[1, -1], [0, 0], [0, 1], [-1, -1], [0, 0]]
    assert observation.contact.dtype == torch.int8


def test_contact_ends_a_climb(env: Relay):
    up = Feedback(lambda observation: tensor([0.0, 0.0, 120.0, 0.0]).expand_as(observation.eta))
    assert env.observe(env.rollout(up, steps=200).end).contact.tolist() == [[1, 1]] * WORLDS


def test_vehicles_tell_each_other_where_they_are(make_pair):
    """What a vehicle takes for its pose, whether that is right or not; entry [i, j] is j's, as i received it."""
    env = make_pair(navigation=Navigation(0.5, 0.1, 0.1, 0.1))
    state = env.rollout(Feedback(lambda observation: 5.0 - observation.eta), steps=7).end
    observation = env.observe(state)
    assert not bool((observation.eta == state.vehicles.eta).any())
    for told, own in ((observation.messages.eta, observation.eta), (observation.messages.nu, observation.nu)):
        assert told.shape == (WORLDS, 2, 2, 4)
        for i in range(2):
            assert torch.equal(told[:, i], own)


def test_targets_are_told_a_step_later(env: Relay):
    """nan until somebody has said something; what has been said stays."""
    tau = torch.zeros(WORLDS, 2, 4, dtype=torch.float64)
    said = torch.arange(30.0, dtype=torch.float64).view(WORLDS, 2, 3)
    state, observation = env.reset()
    assert bool(observation.messages.target.isnan().all())
    assert observation.messages.target.shape == (WORLDS, 2, 2, 3)
    state, observation = env.step(state, tau)
    assert bool(observation.messages.target.isnan().all())
    state, observation = env.step(state, tau, said)
    for _ in range(2):
        assert torch.equal(observation.messages.target, said[:, None].expand(WORLDS, 2, 2, 3))
        state, observation = env.step(state, tau)
    _, observation = env.step(state, tau, said + 1.0)
    assert torch.equal(observation.messages.target[:, 0], said + 1.0)


@pytest.mark.parametrize("gap", [3, 40])
def test_time_is_that_of_the_flight(env: Relay, gap: int):
    state = env.start()
    observation: Observation = env.observe(state._replace(step=state.step + gap))
    assert observation.step.tolist() == [gap] * WORLDS
    assert observation.time.tolist() == pytest.approx([0.05 * gap] * WORLDS, rel=1e-15)
