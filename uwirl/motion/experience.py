"""Where the learner's experience comes from.

A vehicle's problem depends on its pose relative to its link only, so a link may be placed anywhere: a flight towards a
virtual link teaches as much as the mission itself, and one flown segment can be seen from other virtual frames as well.
Where the basis sees ways among obstacles, which stand where they are, so do the virtual links, and none is seen from
elsewhere.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import torch
from torch import Tensor

from uwirl.irl.bellman import Segment
from uwirl.irl.networks import LinearActor
from uwirl.irl.solvers import Batch
from uwirl.motion.excitation import ArenaDraw, Excitation, PoseDraw
from uwirl.motion.linear_agent import LinearAgent
from uwirl.motion.link_frame import relabel
from uwirl.motion.recorder import Recorder
from uwirl.world.agent import Guard, Guarded
from uwirl.world.obstacles import contacts
from uwirl.world.random import RandomStreams
from uwirl.world.relay import Relay
from uwirl.world.scenario import Scenario
from uwirl.world.trajectory import Trajectory, WorldState

# A mission's links are longer than what is drawn by no more than this, and starts no farther, m/m.
BEYOND = 1.05


class FlightState(NamedTuple):
    """Where a flight stands between two legs; as all draws are counter-based, the rest of it follows from this.

    Attributes:
        world: where the vehicles are, and at which step.
        leg: number of the next leg.
    """

    world: WorldState
    leg: int


class Leg(NamedTuple):
    """One leg of a flight.

    Attributes:
        batch: what can be learned from it.
        after: where the flight stands then.
        seconds: of vehicle time that it took.
        contacts: with obstacles on it.
    """

    batch: Batch
    after: FlightState
    seconds: float
    contacts: int


def contacts_while(env: Relay, flown: Trajectory) -> int:
    """Contacts of all vehicles with obstacles."""
    return int(contacts(env.scenario.clearance(flown.states.position, flown.time[:, None])).sum())


class ExperienceSource(Protocol):
    """Flies the newest policy to learn from the flight."""

    def learners(self, env: Relay) -> int:
        """L, how many sets of weights learn from it."""
        ...

    def begin(self, hover: Trajectory) -> FlightState:
        """Where the flight stands when the calibration hover is over."""
        ...

    def fly(self, env: Relay, flight: FlightState, actor: LinearActor, recorder: Recorder, guard: Guard) -> Leg:
        """The next leg, which depends on where the flight stands and on the actor's weights alone."""
        ...


@dataclass(frozen=True)
class Exploration:
    """How the learner flies to learn.

    Attributes:
        leg_s: time between two virtual links, s.
        max_time_s: how long such a flight is worth going on, s; `planner.max_time_s` refers to it.
        excitation_rms, excitation_strength, excitation_band_rad_s: see Excitation.
        across_share: half width of starts across the link, as a share of that along it.
        up_m, yaw_rad, near_share, near_scale: see PoseDraw.
    """

    leg_s: float = 5.0
    max_time_s: float = 600.0
    excitation_rms: Sequence[float] = (36.0, 36.0, 18.0, 3.0)
    excitation_strength: Sequence[float] = (0.2, 1.0)
    excitation_band_rad_s: Sequence[float] = (0.2, 4.2)
    across_share: float = 0.4
    up_m: float = 8.0
    yaw_rad: float = 2.0
    near_share: float = 0.2
    near_scale: float = 0.15

    @property
    def excitation(self) -> Excitation:
        """Added to the policy's control."""
        return Excitation(self.excitation_rms, self.excitation_strength, self.excitation_band_rad_s)

    def poses(self, scenario: Scenario, among_obstacles: bool) -> PoseDraw:
        """Where legs begin relative to their links: as far as in missions, and a little further."""
        source, destination = scenario.source.tolist(), scenario.destination.tolist()
        half = [(b - a) / 2.0 for a, b in zip(source, destination, strict=True)]
        bearing = math.atan2(half[1], half[0])
        c, s = math.cos(bearing), math.sin(bearing)

        def widths(starts: list[list[float]]) -> tuple[float, float, float]:
            errors = [[p - a - h for p, a, h in zip(start, source, half, strict=True)] for start in starts]
            along = BEYOND * max(math.hypot(*half), *(abs(c * x + s * y) for x, y, _ in errors))
            across = max(self.across_share * along, *(BEYOND * abs(c * y - s * x) for x, y, _ in errors))
            return along, across, max(self.up_m, *(BEYOND * abs(z) for _, _, z in errors))

        # Each world by its own starts, so that it draws the same whatever others there are.
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
        """One excited leg to the virtual links of a draw; also x [n + 1, L, d]."""
        world, steps = flight.world, round(self.leg_s / env.scenario.dt)
        eta = world.vehicles.eta
        B, M = eta.shape[:2]
        poses = self.poses(env.scenario, recorder.basis.among_obstacles)
        view = recorder.basis.view(env, poses.frame(env, eta, draw))
        wave = self.excitation.draw(env.streams, M, flight.leg, steps, env.scenario.dt).to(eta.dtype)
        agent = LinearAgent(view, actor, recorder.trim, wave.view(steps, B, M, 4), int(world.step[0]))
        trajectory = env.rollout(Guarded(agent, guard), world, steps)
        return trajectory, view.along(trajectory.carry, trajectory).flatten(1, 2).double()


@dataclass(frozen=True)
class VirtualLinks(Exploration):
    """One continuous flight; every leg a new virtual link is drawn, and segments are seen from other frames too.

    Attributes:
        relabel: from how many further frames each leg is seen.
        relabel_time_s: what was seen so counts exp(-flight time / relabel_time_s) as much as what was flown.
    """

    relabel: int = 4
    relabel_time_s: float = 20.0

    def learners(self, env: Relay) -> int:
        """Each vehicle of each world learns for itself, L = B M."""
        return env.worlds * env.scenario.vehicles

    def begin(self, hover: Trajectory) -> FlightState:
        """The flight goes on where the hover ends."""
        return FlightState(hover.end.detached(), 0)

    def fly(self, env: Relay, flight: FlightState, actor: LinearActor, recorder: Recorder, guard: Guard) -> Leg:
        """The next leg of all vehicles."""
        dt, leg = env.scenario.dt, flight.leg
        draw = leg * (1 + self.relabel)
        flown, x = self.flown(env, flight, draw, actor, recorder, guard)
        weight = math.exp(-(leg + 1) * self.leg_s / self.relabel_time_s) if self.relabel else 0.0
        relabelled = None
        # Below a thousandth the relabelled windows no longer matter and are not made.
        if weight > 1e-3:
            poses = self.poses(env.scenario, recorder.basis.among_obstacles)
            frames = [poses.draw(env.streams, env.scenario.vehicles, draw + k) for k in range(1, 1 + self.relabel)]
            segments = [recorder.segment(relabel(x, pose), flown, dt) for pose in frames]
            relabelled = Segment(*(torch.cat(parts) for parts in zip(*segments, strict=True)))
        batch = Batch((recorder.segment(x, flown, dt), relabelled), (1.0, weight))
        return Leg(batch, FlightState(flown.end.detached(), leg + 1), self.leg_s, contacts_while(env, flown))


@dataclass(frozen=True)
class Parallel(Exploration):
    """Many worlds at once, each with its own virtual link, all teaching one learner.

    Attributes:
        worlds: number of worlds.
    """

    worlds: int = 60

    def learners(self, env: Relay) -> int:
        """One for all, L = 1."""
        return 1

    def begin(self, hover: Trajectory) -> FlightState:
        """All worlds begin where the first vehicle's hover ends."""
        first = hover.end
        state = first.components[:, :1, :1].expand(-1, self.worlds, 1).contiguous()
        target = first.target[:1, :1].expand(self.worlds, 1, 3)
        return FlightState(WorldState(state, first.step[:1].expand(self.worlds).clone(), target), 0)

    def fly(self, env: Relay, flight: FlightState, actor: LinearActor, recorder: Recorder, guard: Guard) -> Leg:
        """The next leg of all worlds, whose vehicle seconds add up."""
        seed = env.streams.seed
        streams = RandomStreams(seed[:1].expand(self.worlds), torch.arange(self.worlds, device=seed.device))
        env = env.on(env.scenario, streams)
        flown, x = self.flown(env, flight, flight.leg, actor, recorder, guard)
        windows = recorder.segment(x, flown, env.scenario.dt)
        pooled = Segment(*(part.flatten(0, 1).unsqueeze(1) for part in windows))
        after, seconds = FlightState(flown.end.detached(), flight.leg + 1), self.worlds * self.leg_s
        return Leg(Batch((pooled,), (1.0,)), after, seconds, contacts_while(env, flown))
