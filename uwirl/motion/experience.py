"""Where the learner's experience comes from.

A vehicle's problem depends on its pose relative to its link only, so a link may be placed anywhere: a flight towards a
virtual link teaches as much as the mission itself, and one flown segment can be relabelled into other virtual frames.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import torch
from torch import Tensor

from uwirl.irl.bellman import BellmanOperator, Segment
from uwirl.irl.networks import LinearActor
from uwirl.irl.solvers import Experience
from uwirl.motion.cost import RelayCost
from uwirl.motion.excitation import Excitation, PoseDraw
from uwirl.motion.features import MotionBasis
from uwirl.motion.link_frame import LinkFrame, relabel
from uwirl.motion.policy import LinkFramePolicy
from uwirl.motion.safety import Guard
from uwirl.world.obstacles import contacts
from uwirl.world.random import RandomStreams, Stream
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

    def segment(self, xi: Tensor, tau: Tensor, dt: float) -> Segment:
        """Windows [S, ...] of xi [n + 1, ..., 8] under held tau [n, ..., 4]."""
        segment = self.operator.segment(
            self.basis.critic(xi),
            self.basis.actor(xi),
            tau - self.trim,
            self.cost.state(xi),
            dt,
            self.window.steps,
            self.window.stride,
        )
        mean_cost = segment.cost / (self.window.steps * dt)
        return segment.weighted(1.0 / (mean_cost + self.floor))


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

    def fly(
        self, env: Relay, state: VehicleState, actor: LinearActor, recorder: Recorder, guard: Guard
    ) -> Iterator[Experience]:
        """Stretches of experience, one a leg, flown with whatever the actor's weights are at the time.

        The B M vehicles of the state learn independently, L = B M.
        """
        dt = env.scenario.dt
        steps = round(self.leg_s / dt)
        leg = 0
        while True:
            pose = self.pose.draw(env.streams, Stream.INITIAL_STATE, leg * (1 + self.relabel))
            trajectory, xi = _fly_leg(env, state, pose, actor, recorder, self.excitation, guard, leg, steps)
            tau = trajectory.tau.flatten(1, 2)
            weight = math.exp(-(leg + 1) * self.leg_s / self.relabel_time_s) if self.relabel else 0.0
            relabelled = None
            # Below a thousandth the relabelled windows no longer matter and are not made.
            if weight > 1e-3:
                copies = [
                    relabel(xi, self.pose.draw(env.streams, Stream.INITIAL_STATE, leg * (1 + self.relabel) + k))
                    for k in range(1, 1 + self.relabel)
                ]
                segments = [recorder.segment(copy, tau, dt) for copy in copies]
                relabelled = Segment(*(torch.cat(parts) for parts in zip(*segments, strict=True)))
            yield Experience(recorder.segment(xi, tau, dt), relabelled, weight, self.leg_s)
            state = trajectory.last
            leg += 1


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

    def fly(
        self, env: Relay, state: VehicleState, actor: LinearActor, recorder: Recorder, guard: Guard
    ) -> Iterator[Experience]:
        """Stretches of experience; the vehicle seconds of all worlds are counted. One learner, L = 1."""
        dt = env.scenario.dt
        steps = round(self.leg_s / dt)
        streams = RandomStreams(
            env.streams.seed[:1].expand(self.worlds), torch.arange(self.worlds, device=env.streams.seed.device)
        )
        env = Relay(env.scenario, env.vehicle, env.channel, streams)
        state = VehicleState(state.components[:, :1, :1].expand(-1, self.worlds, 1).contiguous())
        leg = 0
        while True:
            pose = self.pose.draw(streams, Stream.INITIAL_STATE, leg)
            trajectory, xi = _fly_leg(env, state, pose, actor, recorder, self.excitation, guard, leg, steps)
            windows = recorder.segment(xi, trajectory.tau.flatten(1, 2), dt)
            pooled = Segment(*(part.flatten(0, 1).unsqueeze(1) for part in windows))
            yield Experience(pooled, None, 0.0, self.worlds * self.leg_s)
            state = trajectory.last
            leg += 1


def _fly_leg(
    env: Relay,
    state: VehicleState,
    pose: Tensor,
    actor: LinearActor,
    recorder: Recorder,
    excitation: Excitation,
    guard: Guard,
    leg: int,
    steps: int,
) -> tuple[Trajectory, Tensor]:
    """One excited leg towards the virtual link that puts the vehicle at a pose; also xi [n + 1, L, 8]."""
    B, M = state.components.shape[1:]
    dtype = state.components.dtype
    frame = LinkFrame.seen_as(state, pose.to(dtype).view(B, M, 4))
    wave = excitation.draw(env.streams, leg, steps, env.scenario.dt).to(dtype).view(steps, B, M, 4)
    policy = guard(env, LinkFramePolicy(frame, actor, recorder.trim, wave))
    trajectory = env.rollout(policy, state, steps)
    recorder.watch(env, trajectory)
    return trajectory, frame.relative(trajectory.states).flatten(1, 2).double()
