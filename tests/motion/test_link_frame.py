"""Link-frame coordinates: definitions and invariances."""

import math

import pytest
import torch

from uwirl.motion.link_frame import LinkFrame, relabel
from uwirl.world.agent import Feedback
from uwirl.world.relay import Relay
from uwirl.world.trajectory import WorldState
from uwirl.world.vehicle import VehicleState


def normal(*shape: int, seed: int = 0) -> torch.Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def test_relative_by_hand():
    """A link bearing 90 degrees: along is y, across is -x."""
    frame = LinkFrame(torch.tensor([[1.0, 2.0, -8.0]]), torch.tensor([math.pi / 2]))
    state = VehicleState.from_eta_nu(
        torch.tensor([[[0.0, 5.0, -6.0, math.pi]]]), torch.tensor([[[0.1, 0.2, 0.3, 0.4]]])
    )
    expected = torch.tensor([[[3.0, 1.0, 2.0, math.pi / 2, 0.1, 0.2, 0.3, 0.4]]])
    torch.testing.assert_close(frame.relative(state), expected)


def test_seen_as_places_the_vehicle_where_drawn():
    state = VehicleState.from_eta_nu(normal(5, 2, 4), normal(5, 2, 4, seed=1))
    pose = normal(5, 2, 4, seed=2) * torch.tensor([40.0, 15.0, 8.0, 2.0])
    xi = LinkFrame.seen_as(state.eta, pose).relative(state)
    torch.testing.assert_close(xi[..., :4], pose, rtol=0, atol=1e-12)
    torch.testing.assert_close(xi[..., 4:], state.nu)


def test_relabelled_flight_is_the_flight_from_the_other_pose(make_relay):
    """The dynamics do not change under translation and yaw: relabelling equals flying there."""
    env: Relay = make_relay()
    mid_water = torch.tensor([0.0, 0.0, -10.0, 0.0], dtype=torch.float64)
    start = VehicleState.from_eta_nu(normal(3, 1, 4) + mid_water, 0.3 * normal(3, 1, 4, seed=1))
    tau = 20.0 * normal(60, 3, 1, 4, seed=2)
    frame = LinkFrame(torch.zeros(1, 3, dtype=torch.float64), torch.zeros(1, dtype=torch.float64))
    agent = Feedback(lambda observation: tau[int(observation.step[0])])
    flown = frame.relative(env.rollout(agent, WorldState.of(start), 60).states)
    pose = 2.0 * normal(3, 1, 4, seed=3) + mid_water
    elsewhere = env.rollout(agent, WorldState.of(VehicleState.from_eta_nu(pose, start.nu)), 60)
    torch.testing.assert_close(relabel(flown, pose), frame.relative(elsewhere.states), rtol=0, atol=1e-11)


@pytest.mark.parametrize("turn", [0.7, -2.5])
def test_turning_the_world_changes_nothing(make_relay, turn):
    """Source, destination and vehicle turned together about the vertical: the same xi."""
    c, s = math.cos(turn), math.sin(turn)
    rotation = torch.tensor([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]], dtype=torch.float64)
    eta, nu = normal(4, 1, 4), normal(4, 1, 4, seed=1)
    frame = LinkFrame(normal(1, 3, seed=2), normal(1, seed=3))
    turned_eta = torch.cat([eta[..., :3] @ rotation.T, eta[..., 3:] + turn], -1)
    turned = LinkFrame(frame.target @ rotation.T, frame.bearing + turn)
    torch.testing.assert_close(
        turned.relative(VehicleState.from_eta_nu(turned_eta, nu)),
        frame.relative(VehicleState.from_eta_nu(eta, nu)),
        rtol=0,
        atol=1e-12,
    )
