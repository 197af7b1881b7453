"""Where the learner's experience comes from.

A vehicle's problem depends on its pose relative to its link only, so a link may be placed anywhere: a flight towards a
virtual link teaches as much as the mission itself, and one flown segment can be relabelled into other virtual frames.
Where the basis sees ways among obstacles, which stand where they are, so do the virtual links, and none is relabelled.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from uwirl.irl.bellman import BellmanOperator, Segment
from uwirl.irl.networks import LinearActor
from uwirl.irl.solvers import Experience
from uwirl.motion.cost import RelayCost
from uwirl.motion.excitation import Excitation, PoseDraw
from uwirl.motion.features import MotionBasis
from uwirl.motion.link_frame import relabel
from uwirl.motion.policy import LinearPolicy
from uwirl.motion.safety import Guard
from uwirl.world.obstacles import contacts
from uwirl.world.random import RandomStreams
from uwirl.world.relay import Relay, Trajectory
from uwirl.world.vehicle import VehicleState


@dataclass(frozen=True)
class Window:
    """Windows of integral reinforcement: T = steps x dt, one every stride x dt."""

    steps: int
    stride: int


class Recorder:
    """Turns trajectories into segments for the learner.

    Args:
        basis: features.
        operator: Bellman operator of that basis.
        cost: the learner's running cost.
        trim: tau_trim, [L, 4].
        window: integration windows.
        residual_floor: a window's equation is divided by its mean cost plus this share of the cost scale. Otherwise the
            windows far from the target, where cost is a hundred times larger, decide all weights alone.
    """

    def __init__(
        self,
        basis: MotionBasis,
        operator: BellmanOperator,
        cost: RelayCost,
        trim: Tensor,
        window: Window,
        residual_floor: float,
    ):
        self.basis = basis
        self.operator = operator
        self.cost = cost
        self.trim = trim
        self.window = window
        self.floor = residual_floor * cost.scale.mean()
        self.contacts = 0

    def watch(self, env: Relay, trajectory: Trajectory) -> None:
        """Count the contacts with obstacles while learning."""
        self.contacts += int(
            contacts(env.scenario.clearance(trajectory.states.position, trajectory.time[:, None])).sum()
        )

    def segment(self, x: Tensor, tau: Tensor, afloat: Tensor, dt: float) -> Segment:
        """Windows [S, ...] of x [n + 1, ..., d] under held tau [n, ..., 4].

        Windows in which `afloat` [n + 1, ...] is false count for nothing: surface and floor push too.
        """
        segment = self.operator.segment(
            self.basis.critic(x),
            self.basis.actor(x),
            tau - self.trim,
            self.basis.state_cost(self.cost, x),
            dt,
            self.window.steps,
            self.window.stride,
        )
        mean_cost = segment.cost / (self.window.steps * dt)
        counts = afloat.unfold(0, self.window.steps + 1, self.window.stride).all(-1)
        return segment.weighted(counts / (mean_cost + self.floor))


class FlightState(NamedTuple):
    """Where a flight stands between two legs; as all draws are counter-based, the rest of it follows from this.

    Attributes:
        components: states of the vehicles, [8, B, M].
        step: index, from the beginning of the flight, of the next step.
        leg: number of the next leg.
    """

    components: Tensor
    step: int
    leg: int

    @classmethod
    def after(cls, trajectory: Trajectory, leg: int) -> FlightState:
        """Where a trajectory ends; a copy, which does not hold the rest of it in memory."""
        return cls(trajectory.components[-1].clone(), trajectory.first_step + len(trajectory.tau), leg)


class Leg(NamedTuple):
    """One leg of a flight.

    Attributes:
        experience: what was learned from it.
        after: where the flight stands then.
    """

    experience: Experience
    after: FlightState


@dataclass(frozen=True)
class VirtualLinks:
    """One continuous flight; every leg a new virtual link is drawn, and segments are relabelled into other frames.

    Attributes:
        leg_s: time between two virtual links, s.
        relabel: how many further frames each leg is placed in.
        relabel_time_s: relabelled experience counts exp(-flight time / relabel_time_s) as much as flown.
        excitation, pose: as named.
    """

    leg_s: float
    relabel: int
    relabel_time_s: float
    excitation: Excitation
    pose: PoseDraw

    def begin(self, hover: Trajectory) -> FlightState:
        """The flight goes on where the hover ends."""
        return FlightState.after(hover, 0)

    def fly(
        self, env: Relay, flight: FlightState, actor: LinearActor, recorder: Recorder, guard: Guard
    ) -> Iterator[Leg]:
        """Legs from where a flight stands, flown with whatever the actor's weights are at the time.

        The B M vehicles learn independently, L = B M.
        """
        dt, vehicles = env.scenario.dt, env.scenario.vehicles
        steps = round(self.leg_s / dt)
        while True:
            leg = flight.leg
            draw = leg * (1 + self.relabel)
            flown, x = _fly_leg(env, flight, self.pose, draw, actor, recorder, self.excitation, guard, steps)
            flight = FlightState.after(flown, leg + 1)
            tau, afloat = flown.tau.flatten(1, 2), _afloat(env, flown)
            weight = math.exp(-(leg + 1) * self.leg_s / self.relabel_time_s) if self.relabel else 0.0
            relabelled = None
            # Below a thousandth the relabelled windows no longer matter and are not made.
            if weight > 1e-3:
                copies = [
                    relabel(x, self.pose.draw(env.streams, vehicles, draw + k)) for k in range(1, 1 + self.relabel)
                ]
                segments = [recorder.segment(copy, tau, afloat, dt) for copy in copies]
                relabelled = Segment(*(torch.cat(parts) for parts in zip(*segments, strict=True)))
            yield Leg(Experience(recorder.segment(x, tau, afloat, dt), relabelled, weight, self.leg_s), flight)


@dataclass(frozen=True)
class Parallel:
    """Many worlds at once, each with its own virtual link, all teaching one learner.

    Attributes:
        worlds: number of worlds.
        leg_s: how long all of them fly between updates, s.
        excitation, pose: as named.
    """

    worlds: int
    leg_s: float
    excitation: Excitation
    pose: PoseDraw

    def begin(self, hover: Trajectory) -> FlightState:
        """All worlds begin where the first vehicle's hover ends."""
        start = hover.components[-1, :, :1, :1].expand(-1, self.worlds, 1).contiguous()
        return FlightState(start, hover.first_step + len(hover.tau), 0)

    def fly(
        self, env: Relay, flight: FlightState, actor: LinearActor, recorder: Recorder, guard: Guard
    ) -> Iterator[Leg]:
        """Legs from where the flights stand; the vehicle seconds of all worlds are counted. One learner, L = 1."""
        dt = env.scenario.dt
        steps = round(self.leg_s / dt)
        streams = RandomStreams(
            env.streams.seed[:1].expand(self.worlds), torch.arange(self.worlds, device=env.streams.seed.device)
        )
        env = Relay(env.scenario, env.vehicle, env.channel, streams)
        while True:
            leg = flight.leg
            flown, x = _fly_leg(env, flight, self.pose, leg, actor, recorder, self.excitation, guard, steps)
            flight = FlightState.after(flown, leg + 1)
            windows = recorder.segment(x, flown.tau.flatten(1, 2), _afloat(env, flown), dt)
            pooled = Segment(*(part.flatten(0, 1).unsqueeze(1) for part in windows))
            yield Leg(Experience(pooled, None, 0.0, self.worlds * self.leg_s), flight)


def _fly_leg(
    env: Relay,
    flight: FlightState,
    pose: PoseDraw,
    draw: int,
    actor: LinearActor,
    recorder: Recorder,
    excitation: Excitation,
    guard: Guard,
    steps: int,
) -> tuple[Trajectory, Tensor]:
    """One excited leg to the virtual links of a draw; also x [n + 1, L, d]."""
    state = VehicleState(flight.components)
    B, M = state.components.shape[1:]
    observer = recorder.basis.observer(env, pose.frame(env, state, draw))
    wave = excitation.draw(env.streams, M, flight.leg, steps, env.scenario.dt).to(state.components.dtype)
    wave = wave.view(steps, B, M, 4)
    policy = guard(env, LinearPolicy(observer, actor, recorder.trim, wave, flight.step))
    trajectory = env.rollout(policy, state, steps, flight.step)
    recorder.watch(env, trajectory)
    return trajectory, observer.along(trajectory).flatten(1, 2).double()


def _afloat(env: Relay, trajectory: Trajectory) -> Tensor:
    """Whether a vehicle touches neither surface nor floor, [n + 1, L]."""
    z = trajectory.components[:, 2].flatten(1)
    return (z < 0.0) & (z > -env.scenario.depth)
