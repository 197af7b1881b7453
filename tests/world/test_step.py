"""The world as a pure function of its state: step by step, stopped and continued, worlds apart, bad input."""

from __future__ import annotations

from typing import Any, NamedTuple

import pytest
import torch
from torch import Tensor

from uwirl.world.agent import Feedback, Guarded
from uwirl.world.current import Current
from uwirl.world.navigation import Navigation
from uwirl.world.observation import Observation
from uwirl.world.relay import Relay
from uwirl.world.trajectory import WorldState
from uwirl.world.truth import truth_of

WORLDS, STEPS = 5, 40
DRIFTING = (
    "scenario.obstacles=[{center_m:[-8,-9],radius_m:1,influence_m:5,velocity_mps:[-0.4,0.1]},"
    "{center_m:[14,14],radius_m:2,influence_m:6,velocity_mps:[0,0]}]"
)


class Memory(NamedTuple):
    """Of all that was perceived, [B, M, 4], and where the vehicles mean to go, [B, M, 3]."""

    mean: Tensor
    target: Tensor


class Remembering:
    """Every single thing that it perceives, or has perceived, changes what it does."""

    def init(self, observation: Observation) -> Memory:
        return Memory(torch.zeros_like(observation.eta), observation.position)

    def act(self, carry: Memory, observation: Observation) -> tuple[Tensor, Memory]:
        o, messages = observation, observation.messages
        told = messages.eta.sum(2) + messages.nu.sum(2)
        scalar = o.obstacles.centre.sum((-2, -1)) + o.obstacles.present.sum(-1) + o.contact + 0.1 * o.step[:, None]
        scalar = scalar + messages.target.nan_to_num(3.0).sum((-2, -1)) + messages.snr.nan_to_num(0.0).sum((-2, -1))
        seen = (o.eta - 3.0 * o.nu + 0.1 * told + 0.01 * scalar[..., None]).to(o.eta.dtype)
        mean = 0.9 * carry.mean + 0.1 * seen
        return 10.0 * torch.sin(mean) - seen, Memory(mean, o.position + mean[..., :3])


def worlds(name: str) -> dict[str, Any]:
    """Fields of a scenario: plain water, or all that a world can hold."""
    if name == "plain":
        return {}
    mean = 0.05 * torch.arange(3.0 * WORLDS).view(WORLDS, 3)
    return {
        "current": Current(mean.double(), 0.1, 5.0),
        "detection_range": 3.0,
        "depth": 7.5,
        "navigation": Navigation(0.1, 0.02, 0.01, 0.005, 0.05),
        "streaming": True,
    }


@pytest.fixture(params=["plain", "full"])
def env(request: pytest.FixtureRequest, make_pair) -> Relay:
    return make_pair("channel=acoustic_24khz", DRIFTING, **worlds(request.param))


def row(value: Any, world: int) -> Any:
    """One world's part of an observation."""
    if isinstance(value, tuple):
        return type(value)(*(row(field, world) for field in value))
    return value[world, None] if isinstance(value, torch.Tensor) else value


def identical(a: object, b: object) -> None:
    torch.testing.assert_close(a, b, rtol=0.0, atol=0.0, equal_nan=True)


@pytest.mark.parametrize("dtype", ["float64", "float32"])
@pytest.mark.parametrize("name", ["plain", "full"])
def test_rollout_is_step_by_step(make_pair, name: str, dtype: str):
    env = make_pair("channel=acoustic_24khz", DRIFTING, f"dtype={dtype}", **worlds(name))
    agent = Remembering()
    flight = env.rollout(agent, steps=STEPS)
    state, observation = env.reset()
    carry, detected, heard = agent.init(observation), set(), set()
    for k in range(STEPS):
        detected |= set(observation.obstacles.present.flatten().tolist())
        heard.add(observation.messages.snr.shape[-1] > 0)
        assert state.components.dtype == getattr(torch, dtype)
        assert torch.equal(state.components, flight.components[k])
        tau, carry = agent.act(carry, observation)
        state, observation = env.step(state, tau, carry.target)
    identical(state, flight.end)
    identical(carry, flight.carry)
    assert torch.equal(state.components, flight.components[-1])
    # On the way all that can happen did.
    assert (detected, heard) == (({True, False}, {True, False}) if name == "full" else ({True}, {False}))


def test_step_changes_nothing_that_it_is_given(env: Relay):
    state = env.rollout(Remembering(), steps=9).end
    tau = 30.0 * torch.randn(WORLDS, 2, 4, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    given = WorldState(*(field.clone() for field in state)), tau.clone()
    first, second = env.step(state, tau), env.step(state, tau)
    identical(first, second)
    identical((state, tau), given)
    identical(env.observe(first[0]), first[1])
    # Nor does it look back at what the vehicles have done elsewhere in between.
    env.step(first[0], -tau)
    identical(env.step(state, tau), first)


@pytest.mark.parametrize("name", ["plain", "full"])
def test_a_step_is_one_graph_for_a_compiler(make_pair, name: str):
    """Only a message breaks it, because its readings are there at some steps."""
    env = make_pair("channel=acoustic_24khz", DRIFTING, **worlds(name) | {"streaming": False})
    state, tau = env.start(), torch.full((WORLDS, 2, 4), 30.0, dtype=torch.float64)
    torch.compiler.reset()
    with torch.no_grad():
        identical(torch.compile(env.step, backend="eager", fullgraph=True)(state, tau), env.step(state, tau))


@pytest.mark.slow
def test_a_compiled_flight_differs_by_rounding(make_pair):
    env = make_pair("channel=acoustic_24khz", DRIFTING)
    compiled = Relay(env.scenario, env.vehicle, truth_of(env).channel, env.streams, compiled=True)
    flights = (world.rollout(Remembering(), steps=STEPS) for world in (env, compiled))
    torch.testing.assert_close(*(flight.components for flight in flights), rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("stop", [1, 10, 25])
def test_a_stopped_flight_goes_on_as_if_never_stopped(env: Relay, stop: int):
    agent = Remembering()
    whole = env.rollout(agent, steps=STEPS)
    first = env.rollout(agent, steps=stop)
    second = env.rollout(agent, first.end, STEPS - stop, first.carry)
    assert torch.equal(torch.cat([first.components, second.components[1:]]), whole.components)
    assert torch.equal(torch.cat([first.tau, second.tau]), whole.tau)
    assert torch.equal(torch.cat([first.time, second.time[1:]]), whole.time)
    identical((second.end, second.carry), (whole.end, whole.carry))
    # Without its memory the agent does something else.
    assert not torch.equal(env.rollout(agent, first.end, STEPS - stop).components, second.components)


def test_worlds_at_different_steps_equal_singles(env: Relay):
    state = env.rollout(Remembering(), steps=12).end._replace(step=torch.tensor([10, 0, 7, 200, 19]))
    tau = 30.0 * torch.randn(WORLDS, 2, 4, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    after, seen = env.step(state, tau)
    assert after.step.tolist() == [11, 1, 8, 201, 20]
    for i in range(WORLDS):
        one = torch.tensor([i])
        alone = WorldState(state.components[:, one], state.step[one], state.target[one])
        expected, perceived = env.select(one).step(alone, tau[one])
        close = {"rtol": 0.0, "atol": 1e-12, "equal_nan": True}
        torch.testing.assert_close(after.components[:, one], expected.components, **close)
        single = perceived.messages.snr
        if not single.numel():
            # Where another world has a message, one without hears nothing.
            single = torch.full_like(seen.messages.snr[one], torch.nan)
        perceived = perceived._replace(messages=perceived.messages._replace(snr=single))
        torch.testing.assert_close(row(seen, i), perceived, **close)


def test_many_flights_in_one_world_share_its_water_and_its_noise(make_pair):
    """As those that judge several starts do."""
    gusty = {"current": Current(torch.ones(3, dtype=torch.float64), 0.1, 5.0)}
    one = make_pair("channel=acoustic_24khz", DRIFTING, worlds=1, **worlds("full") | gusty)
    state = WorldState.of(one.start().vehicles)
    many = WorldState(state.components.expand(-1, 3, -1), torch.tensor([0, 9, 30]), state.target.expand(3, -1, -1))
    tau = torch.ones(3, 2, 4, dtype=torch.float64)
    after, seen = one.step(many, tau)
    for k in range(3):
        alone, perceived = one.step(WorldState(state.components, many.step[k : k + 1], state.target), tau[:1])
        torch.testing.assert_close(after.components[:, k : k + 1], alone.components, rtol=0.0, atol=1e-12)
        torch.testing.assert_close(seen.eta[k : k + 1], perceived.eta, rtol=0.0, atol=1e-12)
    assert bool((seen.eta[0] != seen.eta[1]).all())


def test_worlds_at_different_steps_make_no_trajectory(env: Relay):
    state = env.start()._replace(step=torch.tensor([3, 3, 4, 3, 3]))
    with pytest.raises(ValueError, match=r"^worlds at different steps, 3 to 4, make no one trajectory$"):
        env.rollout(Remembering(), state, 5)


TAU = r"^tau{} must be floating-point \[5, 2, 4\] \(world, vehicle, axis\), got {}$"
BAD = [
    (torch.zeros(2, 4), r"torch.float32 \[2, 4\]"),
    (torch.zeros(5, 2, 3, dtype=torch.float64), r"torch.float64 \[5, 2, 3\]"),
    (torch.zeros(4, 2, 4), r"torch.float32 \[4, 2, 4\]"),
    (torch.zeros(5, 2, 4, dtype=torch.int64), r"torch.int64 \[5, 2, 4\]"),
    (torch.zeros(5, 2, 4).numpy(), "ndarray"),
    (None, "NoneType"),
]


@pytest.mark.parametrize(("tau", "got"), BAD)
def test_bad_tau(make_pair, tau: Any, got: str):
    env = make_pair()
    with pytest.raises(ValueError, match=TAU.format("", got)):
        env.step(env.start(), tau)
    with pytest.raises(ValueError, match=TAU.format(" of Feedback.act", got)):
        env.rollout(Feedback(lambda observation: tau), steps=1)
    # It is the agent's fault, not the guard's.
    guarded = Guarded(Feedback(lambda observation: tau), lambda wanted, observation: wanted.clamp(-1.0, 1.0))
    with pytest.raises(ValueError, match=TAU.format(" of Feedback.act", got)):
        env.rollout(guarded, steps=1)


class Careless:
    """An agent that returns the same whatever happens."""

    def __init__(self, action: Any):
        self.action = action

    def init(self, observation: Observation) -> tuple[()]:
        return ()

    def act(self, carry: Any, observation: Observation) -> Any:
        return self.action


@pytest.mark.parametrize("guarded", [False, True])
@pytest.mark.parametrize(
    ("action", "got"),
    [
        (torch.zeros(5, 2, 4), "Tensor"),
        (torch.zeros(2, 2, 4), "Tensor"),
        (None, "NoneType"),
        ((1, 2, 3), "tuple"),
        ([1, 2], "list"),
    ],
)
def test_an_agent_that_returns_no_pair(make_pair, action: Any, got: str, guarded: bool):
    agent = Careless(action)
    with pytest.raises(ValueError, match=rf"^Careless\.act must return \(tau, carry\), got {got}$"):
        make_pair().rollout(Guarded(agent, lambda tau, observation: tau) if guarded else agent, steps=1)


@pytest.mark.parametrize(
    ("target", "got"),
    [
        (torch.zeros(2, 3, dtype=torch.float64), r"torch.float64 \[2, 3\]"),
        (torch.zeros(5, 2, 4), r"torch.float32 \[5, 2, 4\]"),
        (torch.zeros(5, 2, 3, dtype=torch.int32), r"torch.int32 \[5, 2, 3\]"),
        ([0.0, 0.0, -8.0], "list"),
    ],
)
def test_bad_target(make_pair, target: Any, got: str):
    env = make_pair()
    message = rf"^target must be floating-point \[5, 2, 3\] \(world, vehicle, axis\), got {got}$"
    tau = torch.zeros(WORLDS, 2, 4, dtype=torch.float64)
    with pytest.raises(ValueError, match=message):
        env.step(env.start(), tau, target)
    with pytest.raises(ValueError, match=message):
        env.rollout(Careless((tau, Memory(tau, target))), steps=1)


def test_state_of_other_worlds(make_pair):
    env, other = make_pair(), make_pair(worlds=3).start()
    message = "^state of 3 worlds in an environment of 5$"
    with pytest.raises(ValueError, match=message):
        env.step(other, torch.zeros(3, 2, 4, dtype=torch.float64))
    with pytest.raises(ValueError, match=message):
        env.rollout(Remembering(), other, 1)
