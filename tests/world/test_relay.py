"""The relay environment: reset, rollouts, divergence, water that moves, and where sensors lie."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch
from torch import Tensor

from uwirl.world.agent import Agent, Feedback
from uwirl.world.current import Current
from uwirl.world.observation import Observation
from uwirl.world.random import Stream
from uwirl.world.relay import Relay
from uwirl.world.scenario import spread_sensors
from uwirl.world.trajectory import DivergedError, WorldState
from uwirl.world.vehicle import VehicleState

SOURCE, DESTINATION = [-30.0, -30.0, -8.0], [30.0, 30.0, -8.0]
START = [[-12.0, -9.0, -7.0, 0.5], [10.0, 11.0, -6.0, -1.0]]
WORLDS = 5


def tensor(values: list) -> Tensor:
    return torch.tensor(values, dtype=torch.float64)


def held(tau: Tensor) -> Agent:
    """tau [4] or [M, 4], whatever is perceived."""
    return Feedback(lambda observation: tau.expand_as(observation.eta))


def excited(env: Relay) -> Agent:
    """Feedback on the pose plus each world's own random thrust."""

    def law(observation: Observation) -> Tensor:
        noise = env.streams.normal(Stream.EXPLORATION, observation.step, 8).view(-1, 2, 4)
        return 40.0 * noise - 5.0 * (observation.eta - env.scenario.start) - 3.0 * observation.nu

    return Feedback(law)


def test_reset_is_the_start_at_rest(env: Relay):
    state, observation = env.reset()
    assert torch.equal(state.vehicles.eta, tensor(START).expand(WORLDS, 2, 4))
    assert state.vehicles.nu.shape == (WORLDS, 2, 4)
    assert not bool(state.vehicles.nu.any())
    assert state.step.tolist() == [0] * WORLDS
    assert bool(state.target.isnan().all())
    assert state.target.shape == (WORLDS, 2, 3)
    assert torch.equal(observation.eta, state.vehicles.eta)


def test_mission_has_whole_steps(env: Relay):
    assert env.scenario.steps == 1600
    assert env.scenario.vehicles == 2
    assert env.worlds == WORLDS


def test_rollout_saturates(env: Relay):
    limit = env.vehicle.tau_max
    share = tensor([[1.5, -1.5, 0.25, -0.25], [-1.0, 1.0, -7.0, 7.0]])
    flight = env.rollout(held(share * limit), steps=10)
    saturated = (share.clamp(-1.0, 1.0) * limit).expand(WORLDS, 2, 4)
    assert torch.equal(flight.tau, saturated.expand(10, WORLDS, 2, 4))
    state = env.start().vehicles
    for _ in range(10):
        state = env.vehicle.step(state, saturated, 0.05)
    assert torch.equal(flight.last.components, state.components)


def test_agent_sees_the_state_of_its_step(env: Relay):
    seen = []

    def law(observation: Observation) -> Tensor:
        seen.append(observation)
        return env.vehicle.tau_max.expand(WORLDS, 2, 4)

    flight = env.rollout(Feedback(law), steps=4)
    assert [observation.step.tolist() for observation in seen] == [[k] * WORLDS for k in range(4)]
    assert torch.equal(torch.stack([observation.eta for observation in seen]), flight.eta[:-1])
    assert torch.equal(torch.stack([observation.nu for observation in seen]), flight.nu[:-1])
    assert torch.equal(torch.stack([observation.time[0] for observation in seen]), flight.time[:-1])


def test_trajectory_views(env: Relay):
    flight = env.rollout(excited(env), steps=6)
    assert flight.eta.shape == flight.nu.shape == (7, WORLDS, 2, 4)
    assert torch.equal(flight.states.eta, flight.eta)
    assert torch.equal(flight.states.nu, flight.nu)
    assert torch.equal(flight.last.eta, flight.eta[-1])
    assert torch.equal(flight.end.vehicles.eta, flight.eta[-1])
    assert flight.end.step.tolist() == [6] * WORLDS
    assert flight.time.tolist() == pytest.approx([0.0, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3])


def test_worlds_equal_singles(env: Relay):
    start = VehicleState.from_eta_nu(env.start().vehicles.eta + torch.arange(WORLDS)[:, None, None])
    together = env.rollout(excited(env), WorldState.of(start), 20)
    for i in range(WORLDS):
        single = env.select(torch.tensor([i]))
        alone = single.rollout(excited(single), WorldState.of(VehicleState(start.components[:, i : i + 1])), 20)
        torch.testing.assert_close(together.components[:, :, i : i + 1], alone.components, rtol=0.0, atol=1e-12)
        torch.testing.assert_close(together.tau[:, i : i + 1], alone.tau, rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("bad", [0, 7])
def test_agent_that_returns_nan(env: Relay, bad: int):
    def law(observation: Observation) -> Tensor:
        tau = torch.zeros(WORLDS, 2, 4, dtype=torch.float64)
        tau[3, 1, 2] = math.nan if int(observation.step[0]) == bad else 0.0
        return tau

    with pytest.raises(DivergedError, match=rf"^tau is not finite at step {bad} \(t = {0.05 * bad:g} s"):
        env.rollout(Feedback(law), steps=10)


@pytest.mark.parametrize(("component", "quantity", "step"), [(5, "nu", 1), (0, "eta", 0)])
def test_state_that_leaves_the_finite(env: Relay, component: int, quantity: str, step: int):
    state = env.start()
    # A velocity whose square overflows within the first step; a position that never was a number.
    state.components[component, 2, 0] = 1e200 if quantity == "nu" else math.nan
    with pytest.raises(DivergedError, match=rf"^{quantity} is not finite at step {step} "):
        env.rollout(held(torch.zeros(4, dtype=torch.float64)), state, 5)


def test_sensors_follow_the_seed():
    first, again, other = (spread_sensors(16, seed, SOURCE, DESTINATION, torch.float64) for seed in (3, 3, 4))
    assert torch.equal(first, again)
    assert not bool((first == other).any())


def test_sensors_fill_their_box():
    sensors = spread_sensors(20_000, 0, SOURCE, [30.0, 30.0, -2.0], torch.float64)
    quarter = math.hypot(60.0, 60.0, 6.0) / 4.0
    low, high = tensor([-30.0 - quarter, -30.0 - quarter, -12.0]), tensor([30.0 + quarter, 30.0 + quarter, 2.0])
    share = (sensors - low) / (high - low)
    assert sensors.shape == (20_000, 3)
    assert bool(((share >= 0.0) & (share <= 1.0)).all())
    # The chance that 20,000 uniform draws leave the outer 0.1 % of a side empty is 2e-9.
    assert bool((share.amin(0) < 1e-3).all())
    assert bool((share.amax(0) > 1.0 - 1e-3).all())


def test_more_sensors_begin_with_the_same():
    few, many = (spread_sensors(count, 0, SOURCE, DESTINATION, torch.float64) for count in (5, 40))
    assert torch.equal(many[:5], few)


def test_a_current_carries_the_still_water_flight_along(env: Relay):
    """Galileo: in a current c the flight is that in still water plus c t, however the vehicle turns."""
    c = tensor([0.2, -0.3, 0.05])
    tau = 20.0 * torch.randn(100, WORLDS, 2, 4, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    tau[..., 3] /= 10.0
    open_loop = Feedback(lambda observation: tau[int(observation.step[0])])
    still = env.rollout(open_loop, steps=100)
    drifting = env.on(replace(env.scenario, current=Current(c, 0.0, 60.0)), env.streams)
    eta = env.start().vehicles.eta
    psi = eta[..., 3]
    cos, sin = torch.cos(psi), torch.sin(psi)
    along = torch.stack([cos * c[0] + sin * c[1], cos * c[1] - sin * c[0], c[2].expand_as(psi), 0.0 * psi], -1)
    carried = drifting.rollout(open_loop, WorldState.of(VehicleState.from_eta_nu(eta, along)), 100)
    expected = still.eta[..., :3] + c * still.time[:, None, None, None]
    torch.testing.assert_close(carried.eta[..., :3], expected, rtol=0, atol=1e-9)
    torch.testing.assert_close(carried.eta[..., 3], still.eta[..., 3], rtol=0, atol=1e-9)


def test_surface_and_floor_stop_the_centre(env: Relay):
    """Full heave up, then down: 20 m of water."""
    up = env.rollout(held(tensor([0.0, 0.0, 120.0, 0.0])), steps=300)
    assert float(up.eta[..., 2].max()) == 0.0
    assert (up.nu[-1, ..., 2] == 0.0).all()
    down = env.rollout(held(tensor([0.0, 0.0, -120.0, 0.0])), up.end, 600)
    assert float(down.eta[..., 2].min()) == -20.0
    assert float(down.eta[1, ..., 2].max()) < 0.0


def test_worlds_of_a_batch_can_be_taken_out(env: Relay):
    """Starts, obstacles and currents of their own, and their random numbers."""
    start = tensor(START) + torch.arange(WORLDS, dtype=torch.float64)[:, None, None]
    mean = 0.1 * torch.arange(3 * WORLDS, dtype=torch.float64).view(WORLDS, 3)
    scenario = replace(env.scenario, start=start, current=Current(0.1 * mean, 0.05, 10.0))
    batch = env.on(scenario, env.streams)
    agent = Feedback(lambda observation: 10.0 - observation.nu)
    whole = batch.rollout(agent, steps=20)
    part = batch.select(torch.tensor([3, 1])).rollout(agent, steps=20)
    torch.testing.assert_close(part.components, whole.components[..., [3, 1], :], rtol=0, atol=1e-12)
