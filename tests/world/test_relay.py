"""The relay environment: reset, rollouts, divergence, links of a chain, and where sensors lie."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import pytest
import torch
from torch import Tensor

from uwirl import build
from uwirl.world.current import Current
from uwirl.world.random import RandomStreams, Stream
from uwirl.world.relay import Relay
from uwirl.world.scenario import spread_sensors
from uwirl.world.trajectory import DivergedError
from uwirl.world.vehicle import Vehicle, VehicleState

SOURCE, DESTINATION = [-30.0, -30.0, -8.0], [30.0, 30.0, -8.0]
START = [[-12.0, -9.0, -7.0, 0.5], [10.0, 11.0, -6.0, -1.0]]
WORLDS = 5


def tensor(values: list) -> Tensor:
    return torch.tensor(values, dtype=torch.float64)


@pytest.fixture
def env(make_config) -> Relay:
    """Two vehicles between the paper's nodes."""
    config = make_config()
    scenario = replace(
        build.make_scenario(config), source=tensor(SOURCE), destination=tensor(DESTINATION), start=tensor(START)
    )
    streams = RandomStreams.worlds(11, WORLDS)
    return Relay(scenario, Vehicle(**config.vehicle.values()), build.make_channel(config.channel), streams)


def world_alone(env: Relay, i: int) -> Relay:
    streams = RandomStreams(env.streams.seed[i : i + 1], env.streams.world[i : i + 1])
    return Relay(env.scenario, env.vehicle, env.channel, streams)


def excited_policy(env: Relay):
    """Feedback on the pose plus each world's own random thrust."""

    def policy(state: VehicleState, step: int) -> Tensor:
        noise = env.streams.normal(Stream.EXPLORATION, step, 8).view(-1, 2, 4)
        return 40.0 * noise - 5.0 * (state.eta - env.scenario.start) - 3.0 * state.nu

    return policy


def test_reset_is_the_start_at_rest(env: Relay):
    state = env.reset()
    assert state.eta.shape == state.nu.shape == (WORLDS, 2, 4)
    assert torch.equal(state.eta, tensor(START).expand(WORLDS, 2, 4))
    assert not bool(state.nu.any())


def test_mission_has_whole_steps(env: Relay):
    assert env.scenario.steps == 1600
    assert env.scenario.vehicles == 2


def test_rollout_saturates(env: Relay):
    limit = env.vehicle.tau_max
    share = tensor([[1.5, -1.5, 0.25, -0.25], [-1.0, 1.0, -7.0, 7.0]])
    flight = env.rollout(lambda state, step: (share * limit).expand(WORLDS, 2, 4), env.reset(), 10)
    held = (share.clamp(-1.0, 1.0) * limit).expand(WORLDS, 2, 4)
    assert torch.equal(flight.tau, held.expand(10, WORLDS, 2, 4))
    state = env.reset()
    for _ in range(10):
        state = env.vehicle.step(state, held, 0.05)
    assert torch.equal(flight.last.components, state.components)


def test_policy_sees_the_state_of_its_step(env: Relay):
    seen = []

    def policy(state: VehicleState, step: int) -> Tensor:
        seen.append((step, state.components.clone()))
        return env.vehicle.tau_max.expand(WORLDS, 2, 4)

    flight = env.rollout(policy, env.reset(), 4)
    assert [step for step, _ in seen] == [0, 1, 2, 3]
    assert torch.equal(torch.stack([components for _, components in seen]), flight.components[:-1])


def test_trajectory_views(env: Relay):
    flight = env.rollout(excited_policy(env), env.reset(), 6)
    assert flight.eta.shape == flight.nu.shape == (7, WORLDS, 2, 4)
    assert torch.equal(flight.states.eta, flight.eta)
    assert torch.equal(flight.states.nu, flight.nu)
    assert torch.equal(flight.last.eta, flight.eta[-1])
    assert flight.time.tolist() == pytest.approx([0.0, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3])


def test_worlds_equal_singles(env: Relay):
    start = VehicleState.from_eta_nu(env.reset().eta + torch.arange(WORLDS)[:, None, None])
    together = env.rollout(excited_policy(env), start, 20)
    for i in range(WORLDS):
        single = world_alone(env, i)
        alone = single.rollout(excited_policy(single), VehicleState(start.components[:, i : i + 1]), 20)
        torch.testing.assert_close(together.components[:, :, i : i + 1], alone.components, rtol=0.0, atol=1e-12)
        torch.testing.assert_close(together.tau[:, i : i + 1], alone.tau, rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("bad", [0, 7])
def test_policy_that_returns_nan(env: Relay, bad: int):
    def policy(state: VehicleState, step: int) -> Tensor:
        tau = torch.zeros(WORLDS, 2, 4, dtype=torch.float64)
        tau[3, 1, 2] = math.nan if step == bad else 0.0
        return tau

    with pytest.raises(DivergedError, match=rf"^tau is not finite at step {bad} \(t = {0.05 * bad:g} s"):
        env.rollout(policy, env.reset(), 10)


@pytest.mark.parametrize(("component", "quantity", "step"), [(5, "nu", 1), (0, "eta", 0)])
def test_state_that_leaves_the_finite(env: Relay, component: int, quantity: str, step: int):
    state = env.reset()
    # A velocity whose square overflows within the first step; a position that never was a number.
    state.components[component, 2, 0] = 1e200 if quantity == "nu" else math.nan
    with pytest.raises(DivergedError, match=rf"^{quantity} is not finite at step {step} "):
        env.rollout(lambda s, k: torch.zeros(WORLDS, 2, 4, dtype=torch.float64), state, 5)


def test_chain_runs_from_source_to_destination(env: Relay):
    chain = env.chain(env.reset().position)
    assert torch.equal(chain, tensor([SOURCE, START[0][:3], START[1][:3], DESTINATION]).expand(WORLDS, 4, 3))


def test_link_capacities_by_hand(env: Relay):
    nodes = [SOURCE, START[0][:3], START[1][:3], DESTINATION]
    expected = []
    for p, q in pairwise(nodes):
        snr_dB = -60.0 - 50.0 * math.log10(math.dist(p, q)) + 160.0
        expected.append(10.0 * math.log2(1.0 + 10.0 ** (snr_dB / 10.0)))
    assert env.link_capacities_kbps(tensor(START)[:, :3]).tolist() == pytest.approx(expected, rel=1e-12)


def test_even_chain_of_two_reaches_the_papers_capacity(env: Relay):
    links = env.link_capacities_kbps(tensor([[-10.0, -10.0, -8.0], [10.0, 10.0, -8.0]]).expand(WORLDS, 2, 3))
    assert links.shape == (WORLDS, 3)
    assert [f"{c:.3f}" for c in links.flatten().tolist()] == ["91.122"] * (3 * WORLDS)


@pytest.fixture
def shadowed(env: Relay) -> Relay:
    return Relay(env.scenario, env.vehicle, replace(env.channel, zeta_dB=3.0, varphi_m=15.0), env.streams)


def test_shadowed_capacities_by_hand(shadowed: Relay):
    """The field's ends stand in the order source, destination, vehicles."""
    position = shadowed.reset().position
    nodes = [tensor(SOURCE).expand(WORLDS, 3), *position.unbind(-2), tensor(DESTINATION).expand(WORLDS, 3)]
    links = [(nodes[0], nodes[1]), (nodes[1], nodes[2]), (nodes[3], nodes[2])]
    expected = []
    for p, q in links:
        fading = shadowed.shadowing(p[:, None], q[:, None])[:, 0]
        snr = shadowed.channel.mean_snr_dB(torch.linalg.vector_norm(p - q, dim=-1)) + fading
        expected.append(shadowed.channel.capacity_kbps(snr))
    links = shadowed.link_capacities_kbps(position, shadowed=True)
    torch.testing.assert_close(links, torch.stack(expected, -1), rtol=1e-12, atol=0.0)
    assert not bool(torch.isclose(links, shadowed.link_capacities_kbps(position)).any())


def test_a_link_has_the_same_shadowing_whenever_it_is_read(shadowed: Relay):
    position = shadowed.reset().position
    series = shadowed.link_capacities_kbps(torch.stack([position, position + 1.0, position]), shadowed=True)
    assert torch.equal(series[0], series[2])
    assert not bool(torch.isclose(series[0], series[1]).any())
    # The first link does not feel where the second vehicle is, nor its world how many others there are.
    other = position.clone()
    other[:, 1] += 5.0
    assert torch.equal(shadowed.link_capacities_kbps(other, shadowed=True)[:, 0], series[0, :, 0])
    alone = shadowed.select(torch.tensor([3])).link_capacities_kbps(position[3:4], shadowed=True)
    torch.testing.assert_close(alone, series[0, 3:4], rtol=1e-12, atol=0.0)


def test_without_shadowing_capacities_are_the_mean(shadowed: Relay):
    still = Relay(shadowed.scenario, shadowed.vehicle, replace(shadowed.channel, zeta_dB=0.0), shadowed.streams)
    position = still.reset().position
    assert torch.equal(still.link_capacities_kbps(position, shadowed=True), still.link_capacities_kbps(position))


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
    still = env.rollout(lambda _, k: tau[k], env.reset(), 100)
    drifting = env.on(replace(env.scenario, current=Current(c, 0.0, 60.0)), env.streams)
    psi = env.reset().eta[..., 3]
    cos, sin = torch.cos(psi), torch.sin(psi)
    along = torch.stack([cos * c[0] + sin * c[1], cos * c[1] - sin * c[0], c[2].expand_as(psi), 0.0 * psi], -1)
    start = VehicleState.from_eta_nu(env.reset().eta, along)
    carried = drifting.rollout(lambda _, k: tau[k], start, 100)
    expected = still.eta[..., :3] + c * still.time[:, None, None, None]
    torch.testing.assert_close(carried.eta[..., :3], expected, rtol=0, atol=1e-9)
    torch.testing.assert_close(carried.eta[..., 3], still.eta[..., 3], rtol=0, atol=1e-9)


def test_surface_and_floor_stop_the_centre(env: Relay):
    """Full heave up, then down: 20 m of water."""
    up = env.rollout(lambda *_: tensor([0.0, 0.0, 120.0, 0.0]).expand(WORLDS, 2, 4), env.reset(), 300)
    assert float(up.eta[..., 2].max()) == 0.0
    assert (up.nu[-1, ..., 2] == 0.0).all()
    down = env.rollout(lambda *_: tensor([0.0, 0.0, -120.0, 0.0]).expand(WORLDS, 2, 4), up.last, 600)
    assert float(down.eta[..., 2].min()) == -20.0
    assert float(down.eta[1, ..., 2].max()) < 0.0


def test_a_flight_goes_on_where_the_last_one_ended(env: Relay):
    """Two flights one after the other are one flight: time goes on with the steps."""
    gusty = env.on(replace(env.scenario, current=Current(tensor([0.1, 0.0, 0.0]), 0.1, 5.0)), env.streams)
    policy = excited_policy(env)
    whole = gusty.rollout(policy, env.reset(), 40)
    first = gusty.rollout(policy, env.reset(), 25)
    second = gusty.rollout(policy, first.last, 15, first_step=25)
    assert torch.equal(torch.cat([first.components, second.components[1:]]), whole.components)
    assert torch.equal(second.time, whole.time[25:])


def test_worlds_of_a_batch_can_be_taken_out(env: Relay):
    """Starts, obstacles and currents of their own, and their random numbers."""
    start = tensor(START) + torch.arange(WORLDS, dtype=torch.float64)[:, None, None]
    mean = 0.1 * torch.arange(3 * WORLDS, dtype=torch.float64).view(WORLDS, 3)
    scenario = replace(env.scenario, start=start, current=Current(0.1 * mean, 0.05, 10.0))
    batch = env.on(scenario, env.streams)
    policy = lambda state, step: 10.0 - state.nu  # noqa: E731
    whole = batch.rollout(policy, batch.reset(), 20)
    picked = batch.select(torch.tensor([3, 1]))
    part = picked.rollout(policy, picked.reset(), 20)
    torch.testing.assert_close(part.components, whole.components[..., [3, 1], :], rtol=0, atol=1e-12)
