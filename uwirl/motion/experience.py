"""Flights that give the learner its experience.

A vehicle's problem depends only on its pose relative to its link, so links can be placed anywhere. A flight to a
virtual link is as informative as the mission itself, and a flown segment can be transformed into other virtual frames
(relabelled). A basis with routes among obstacles is different: obstacles are fixed, so virtual links are drawn inside
the arena, and segments are not relabelled.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import torch
from torch import Tensor

from uwirl.irl.bellman import Segment
from uwirl.irl.networks import LinearActor
from uwirl.irl.solvers import Batch
from uwirl.motion.excitation import ArenaDraw, Excitation, PoseDraw
from uwirl.motion.linear_agent import Excited, LinearAgent
from uwirl.motion.link_frame import LinkFrame, relabel
from uwirl.motion.recorder import Recorder
from uwirl.world.agent import Agent, Guard, Guarded
from uwirl.world.obstacles import contacts
from uwirl.world.random import RandomStreams
from uwirl.world.relay import Relay
from uwirl.world.scenario import Scenario
from uwirl.world.trajectory import Trajectory, WorldState

# Widths of the drawn poses relative to the largest distances in missions, m/m.
BEYOND = 1.05


class FlightState(NamedTuple):
    """State of a flight between two legs; it determines the rest of the flight, because all draws are counter-based.

    Attributes:
        world: state of the worlds.
        leg: number of the next leg.
        carry: memory of the agent that flies on; None to begin with the next leg.
    """

    world: WorldState
    leg: int
    carry: Any = None


class Pilot(NamedTuple):
    """Who flies the mission itself.

    Attributes:
        agent: with the newest policy.
        frame: links of the mission.
        probing: whether the vehicle is still to be excited.
    """

    agent: Agent
    frame: LinkFrame
    probing: bool


class Leg(NamedTuple):
    """One leg of a flight.

    Attributes:
        batch: its experience for the learner.
        after: state of the flight after it.
        seconds: its vehicle time, s.
        contacts: number of contacts with obstacles.
        flown: the flight itself.
    """

    batch: Batch
    after: FlightState
    seconds: float
    contacts: int
    flown: Trajectory


def contacts_while(env: Relay, flown: Trajectory) -> int:
    """Number of contacts of all vehicles with obstacles during a flight."""
    return int(contacts(env.scenario.clearance(flown.states.position, flown.time[:, None])).sum())


class ExperienceSource(Protocol):
    """Flies the newest policy and collects experience."""

    def learners(self, env: Relay) -> int:
        """L, the number of sets of weights that learn from it."""
        ...

    @property
    def hovers(self) -> bool:
        """Whether the vehicle hovers first, to measure its trim."""
        ...

    def begin(self, world: WorldState) -> FlightState:
        """State of the flight at its beginning, after the calibration hover if there is one."""
        ...

    def fly(
        self,
        env: Relay,
        flight: FlightState,
        actor: LinearActor,
        recorder: Recorder,
        guard: Guard,
        pilot: Callable[[], Pilot],
    ) -> Leg:
        """Fly the next leg; it depends only on the state of the flight and the actor's weights.

        `pilot` is asked for by sources that fly the mission.
        """
        ...


@dataclass(frozen=True)
class Exploration:
    """Settings of the exploration flights.

    Attributes:
        leg_s: time between two virtual links, s.
        max_time_s: sensible duration of such a flight, s; `planner.max_time_s` refers to it.
        model_time_s, model_window_s: sensible times for the identification from it, s; likewise.
        excitation_rms, excitation_strength, excitation_band_rad_s: see Excitation.
        across_share: half width of starts across the link, as a fraction of that along it.
        up_m, yaw_rad, near_share, near_scale: see PoseDraw.
    """

    leg_s: float = 5.0
    max_time_s: float = 600.0
    model_time_s: float = 64.0
    model_window_s: float = 1.0
    excitation_rms: Sequence[float] = (36.0, 36.0, 18.0, 3.0)
    excitation_strength: Sequence[float] = (0.2, 1.0)
    excitation_band_rad_s: Sequence[float] = (0.2, 4.2)
    across_share: float = 0.4
    up_m: float = 8.0
    yaw_rad: float = 2.0
    near_share: float = 0.2
    near_scale: float = 0.15

    @property
    def hovers(self) -> bool:
        """Flights for learning alone begin with a hover."""
        return True

    @property
    def excitation(self) -> Excitation:
        """The excitation that is added to the policy's control."""
        return Excitation(self.excitation_rms, self.excitation_strength, self.excitation_band_rad_s)

    def poses(self, scenario: Scenario, among_obstacles: bool) -> PoseDraw:
        """Distribution of start poses relative to the links: distances as in missions, and slightly larger."""
        source, destination = scenario.source.tolist(), scenario.destination.tolist()
        half = [(b - a) / 2.0 for a, b in zip(source, destination, strict=True)]
        bearing = math.atan2(half[1], half[0])
        c, s = math.cos(bearing), math.sin(bearing)

        def widths(starts: list[list[float]]) -> tuple[float, float, float]:
            errors = [[p - a - h for p, a, h in zip(start, source, half, strict=True)] for start in starts]
            along = BEYOND * max(math.hypot(*half), *(abs(c * x + s * y) for x, y, _ in errors))
            across = max(self.across_share * along, *(BEYOND * abs(c * y - s * x) for x, y, _ in errors))
            return along, across, max(self.up_m, *(BEYOND * abs(z) for _, _, z in errors))

        # Separately for each world, so that its draws do not depend on the other worlds of the batch.
        starts = scenario.start[..., :3]
        each = [widths(world) for world in starts.reshape(-1, *starts.shape[-2:]).tolist()]
        reach = torch.tensor(each, dtype=torch.float64).T if starts.ndim == 3 else each[0]
        along, across, up = reach
        return (ArenaDraw if among_obstacles else PoseDraw)(
            along, across, up, self.yaw_rad, self.near_share, self.near_scale
        )

    def flown(
        self, env: Relay, flight: FlightState, draw: int, actor: LinearActor, recorder: Recorder, guard: Guard
    ) -> tuple[Trajectory, Tensor]:
        """Fly one leg with excitation to the virtual links of a draw; returns also x [n + 1, L, d]."""
        world, steps = flight.world, round(self.leg_s / env.scenario.dt)
        eta = world.vehicles.eta
        B, M = eta.shape[:2]
        poses = self.poses(env.scenario, recorder.basis.among_obstacles)
        view = recorder.basis.view(env, poses.frame(env, eta, draw))
        wave = self.excitation.draw(env.streams, M, flight.leg, steps, env.scenario.dt).to(eta.dtype)
        agent = Excited(LinearAgent(view, actor, recorder.trim), wave.view(steps, B, M, 4), int(world.step[0]))
        trajectory = env.rollout(Guarded(agent, guard), world, steps)
        return trajectory, view.along(trajectory.carry, trajectory).flatten(1, 2).double()


@dataclass(frozen=True)
class VirtualLinks(Exploration):
    """One continuous flight; each leg has a new virtual link, and its segments are also relabelled to other frames.

    Attributes:
        relabel: number of other frames for each leg.
        relabel_time_s: relabelled segments are weighted by exp(-flight time / relabel_time_s), flown ones by 1, s.
    """

    relabel: int = 4
    relabel_time_s: float = 20.0

    def learners(self, env: Relay) -> int:
        """Each vehicle of each world learns its own weights, L = B M."""
        return env.worlds * env.scenario.vehicles

    def begin(self, world: WorldState) -> FlightState:
        """The flight continues from the end of the hover."""
        return FlightState(world.detached(), 0)

    def fly(
        self,
        env: Relay,
        flight: FlightState,
        actor: LinearActor,
        recorder: Recorder,
        guard: Guard,
        pilot: Callable[[], Pilot],
    ) -> Leg:
        """Fly the next leg with all vehicles."""
        draw = flight.leg * (1 + self.relabel)
        return self._learned(env, flight, *self.flown(env, flight, draw, actor, recorder, guard), recorder)

    def _learned(self, env: Relay, flight: FlightState, flown: Trajectory, x: Tensor, recorder: Recorder) -> Leg:
        """What a flown leg teaches, x [n + 1, L, d]."""
        dt, leg = env.scenario.dt, flight.leg
        draw = leg * (1 + self.relabel)
        weight = math.exp(-(leg + 1) * self.leg_s / self.relabel_time_s) if self.relabel else 0.0
        relabelled = None
        # Relabelled windows with a weight below 0.001 have no effect and are not computed.
        if weight > 1e-3:
            poses = self.poses(env.scenario, recorder.basis.among_obstacles)
            frames = [poses.draw(env.streams, env.scenario.vehicles, draw + k) for k in range(1, 1 + self.relabel)]
            segments = [recorder.segment(relabel(x, pose), flown, dt) for pose in frames]
            relabelled = Segment(*(torch.cat(parts) for parts in zip(*segments, strict=True)))
        batch = Batch((recorder.segment(x, flown, dt), relabelled), (1.0, weight))
        after = FlightState(flown.end.detached(), leg + 1)
        return Leg(batch, after, self.leg_s, contacts_while(env, flown), flown)


@dataclass(frozen=True)
class Missions(VirtualLinks):
    """The mission itself is the experience: from its start, with nothing known, one mission after the other.

    Thrust is excited until a model of the vehicle is known. The agent's memory passes from leg to leg.
    """

    @property
    def hovers(self) -> bool:
        """The mission begins at once."""
        return False

    def fly(
        self,
        env: Relay,
        flight: FlightState,
        actor: LinearActor,
        recorder: Recorder,
        guard: Guard,
        pilot: Callable[[], Pilot],
    ) -> Leg:
        """Fly the next seconds of a mission."""
        agent, frame, probing = pilot()
        world, carry, dt = flight.world, flight.carry, env.scenario.dt
        steps, first = round(self.leg_s / dt), int(world.step[0])
        if first and first % env.scenario.steps == 0:
            world, carry = env.start()._replace(step=world.step), None
        steps = min(steps, env.scenario.steps - first % env.scenario.steps)
        if probing:
            B, M = world.vehicles.eta.shape[:2]
            wave = self.excitation.draw(env.streams, M, flight.leg, steps, dt).to(world.components)
            agent = Excited(agent, wave.view(steps, B, M, 4), first)
        flown = env.rollout(Guarded(agent, guard), world, steps, carry)
        x = recorder.basis.view(env, frame).along((), flown).flatten(1, 2).double()
        leg = self._learned(env, flight, flown, x, recorder)
        return leg._replace(after=leg.after._replace(carry=flown.carry), seconds=steps * dt)


@dataclass(frozen=True)
class Parallel(Exploration):
    """Many worlds in parallel, each with its own virtual link; one learner uses all their experience.

    Attributes:
        worlds: number of worlds.
    """

    worlds: int = 60

    def learners(self, env: Relay) -> int:
        """One learner for all worlds, L = 1."""
        return 1

    def begin(self, world: WorldState) -> FlightState:
        """All worlds begin at the end of the first vehicle's hover."""
        state = world.components[:, :1, :1].expand(-1, self.worlds, 1).contiguous()
        target = world.target[:1, :1].expand(self.worlds, 1, 3)
        return FlightState(WorldState(state, world.step[:1].expand(self.worlds).clone(), target), 0)

    def fly(
        self,
        env: Relay,
        flight: FlightState,
        actor: LinearActor,
        recorder: Recorder,
        guard: Guard,
        pilot: Callable[[], Pilot],
    ) -> Leg:
        """Fly the next leg in all worlds; their vehicle seconds add up."""
        seed = env.streams.seed
        streams = RandomStreams(seed[:1].expand(self.worlds), torch.arange(self.worlds, device=seed.device))
        env = env.on(env.scenario, streams)
        flown, x = self.flown(env, flight, flight.leg, actor, recorder, guard)
        windows = recorder.segment(x, flown, env.scenario.dt)
        pooled = Segment(*(part.flatten(0, 1).unsqueeze(1) for part in windows))
        after, seconds = FlightState(flown.end.detached(), flight.leg + 1), self.worlds * self.leg_s
        return Leg(Batch((pooled,), (1.0,)), after, seconds, contacts_while(env, flown), flown)
