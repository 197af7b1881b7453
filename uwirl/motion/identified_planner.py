"""planner=identified: a model of the vehicle learned from a minute of its flight, and optimal flights on that model."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import torch
from torch import Tensor

from uwirl.irl.networks import LinearActor
from uwirl.motion.calibration import calibration_hover
from uwirl.motion.cost import CostWeights
from uwirl.motion.cruise import Cruise, declared_model
from uwirl.motion.experience import Exploration, VirtualLinks, contacts_while
from uwirl.motion.features import LinkFrameBasis
from uwirl.motion.guidance import Geodesic, GeodesicAgent
from uwirl.motion.identification import Identified, Log, Windows, identify_flights
from uwirl.motion.linear_agent import Excited, LinearAgent, LinkController, LinkView
from uwirl.motion.mission import Mission
from uwirl.motion.planned_agent import PlannedAgent, PlanSettings
from uwirl.motion.route import Router
from uwirl.motion.route_tracker import RouteTracker
from uwirl.motion.safety import EnergyGuard, Limits
from uwirl.motion.vehicle_model import Fossen, Regressor, VehicleModel
from uwirl.snr.estimate import ChannelEstimate
from uwirl.world.agent import Agent, Guard, Guarded
from uwirl.world.relay import Relay
from uwirl.world.trajectory import Trajectory

# Saturation lengths of the start policy's features, m.
SCALES = (2.0, float("inf"))


class UnidentifiedError(ValueError):
    """The flight does not tell the parameters of the vehicle."""


class Learned(NamedTuple):
    """What has been learned after so many seconds of flight.

    Attributes:
        identified: parameters and standard errors; None while there are fewer windows than parameters.
        trim: tau that holds the vehicle at rest, [4], from the hover.
        seconds: vehicle time, s, of all vehicles.
        contacts: with obstacles, while learning.
        flown: the newest leg; None for the hover.
        in_mission: whether the mission is flown.
    """

    identified: Identified | None
    trim: Tensor
    seconds: float
    contacts: int
    flown: Trajectory | None = None
    in_mission: bool = False


@dataclass(frozen=True)
class IdentifiedPlanner:
    """Learns a model in flight, then plans on it.

    Attributes:
        cost: weights of the running cost.
        guard: guard between agent and thrusters while learning; the default one if None.
        guidance: the map's settings, and the law that flies where there is no good plan.
        experience: excitation and virtual links of the learning flight.
        calibration_s: duration of the hover that finds the trim, s.
        max_time_s: duration of the learning flight, the hover included, s.
        window_s: of the integrals of one row, s.
        most_doubt: largest standard error, as a share of its parameter, of inertia.
        inertia_lower: declared lower bounds, kg, kg m^2: with them it begins to fly with experience=mission.
        node_s, replan_s, refine: see PlanSettings.
        regressor: structure of the model.
    """

    cost: CostWeights = field(default_factory=CostWeights)
    guard: Guard | None = None
    guidance: Geodesic = field(default_factory=Geodesic)
    experience: Exploration = field(default_factory=VirtualLinks)
    calibration_s: float = 14.0
    max_time_s: float = 64.0
    window_s: float = 1.0
    most_doubt: float = 0.1
    inertia_lower: Sequence[float] = (12.0, 12.0, 12.0, 0.2)
    node_s: float = 0.1
    replan_s: float = 2.0
    refine: int = 2
    regressor: Regressor = field(default_factory=Fossen)

    def learn(self, env: Relay, estimate: ChannelEstimate) -> Iterator[Learned]:
        """Hover, then fly to virtual links with excitation, or the mission; yields what is known after each leg.

        Raises:
            UnidentifiedError: the inertia remains in doubt at the end.
        """
        if not self.experience.hovers:
            yield from self._in_mission(env, estimate)
            return
        mission, guard = Mission(env, estimate.channel, self.cost), self._guard(env)
        basis = LinkFrameBasis(mission.cost, list(SCALES))
        actor = LinearActor(basis, basis.start_weights()[None])
        hover, trim = calibration_hover(env, actor, mission.cost, self.calibration_s, guard)
        trim = trim.mean(0)
        dt, vehicles = env.scenario.dt, env.worlds * env.scenario.vehicles
        steps = round(self.window_s / dt)
        windows = Windows(self.regressor, dt, steps, steps, env.scenario.depth)
        logs, world, leg, flown = [Log.of(hover)], hover.end.detached(), 0, None
        hit, seconds = contacts_while(env, hover), float(hover.time[-1])
        current = trim.new_zeros(2).double()
        poses = self.experience.poses(env.scenario, bool(env.scenario.obstacles.number))
        while True:
            # A hover alone tells neither drag nor current.
            known = identify_flights(windows, logs, env.vehicle.tau_max, current) if leg else None
            current = current if known is None else known.current
            yield Learned(known, trim, seconds * vehicles, hit, flown)
            if seconds >= self.max_time_s:
                break
            legs = round(self.experience.leg_s / dt)
            view = LinkView(poses.frame(env, world.vehicles.eta, leg))
            wave = self.experience.excitation.draw(env.streams, env.scenario.vehicles, leg, legs, dt)
            wave = wave.to(trim).view(legs, *world.vehicles.eta.shape)
            agent = Excited(LinearAgent(view, actor, trim), wave.to(world.vehicles.eta), int(world.step[0]))
            flown = env.rollout(Guarded(agent, guard), world, legs)
            logs.append(Log.of(flown))
            hit, seconds = hit + contacts_while(env, flown), seconds + self.experience.leg_s
            world, leg = flown.end.detached(), leg + 1
        self._check(known)

    def _in_mission(self, env: Relay, estimate: ChannelEstimate) -> Iterator[Learned]:
        """Fly the mission with nothing known; plan once the model is, and anew whenever the flight is twice as long."""
        scenario, guard = env.scenario, self._guard(env)
        dt, vehicles = scenario.dt, env.worlds * scenario.vehicles
        steps = round(self.window_s / dt)
        windows = Windows(self.regressor, dt, steps, steps, scenario.depth)
        tau_max = env.vehicle.tau_max
        still = torch.zeros(2, dtype=torch.float64, device=tau_max.device)
        learned = Learned(None, tau_max.new_zeros(4).double(), 0.0, 0)
        declared = declared_model(torch.tensor(list(self.inertia_lower)), tau_max)
        agent: Agent = self._reactive(env, Mission(env, estimate.channel, self.cost), learned.trim, declared)
        carry = None
        world, log, flown_steps, planned = env.start(), None, 0, 0
        while flown_steps < scenario.steps:
            count = min(round(self.experience.leg_s / dt), scenario.steps - flown_steps)
            pilot = agent
            if not planned:
                wave = self.experience.excitation.draw(env.streams, scenario.vehicles, flown_steps, count, dt)
                pilot = Excited(agent, wave.to(world.components).view(count, *world.vehicles.eta.shape), flown_steps)
            flown = env.rollout(Guarded(pilot, guard), world, count, carry)
            world, carry, flown_steps = flown.end.detached(), flown.carry, flown_steps + count
            log = Log.of(flown) if log is None else Log.joined([log, Log.of(flown)])
            known, seconds = learned.identified, flown_steps * dt
            if seconds >= max(self.experience.model_time_s, 2.0 * planned * dt):
                found = identify_flights(windows, [log], tau_max, still if known is None else known.current)
                if found is not None and not found.doubtful_inertia(self.regressor, self.most_doubt):
                    known, planned = found, flown_steps
            hit = learned.contacts + contacts_while(env, flown)
            trim = learned.trim if known is None else known.model(self.regressor, tau_max.device).trim[0]
            learned = Learned(known, trim, seconds * vehicles, hit, flown, in_mission=True)
            if planned == flown_steps:
                agent, carry = self.agent(env, estimate, learned), None
            yield learned
        self._check(learned.identified)

    def _guard(self, env: Relay) -> Guard:
        return self.guard or EnergyGuard(Limits.of(env))

    def _check(self, known: Identified | None) -> None:
        if known is None:
            raise UnidentifiedError(
                "planner.max_time_s: the flight tells too little of the model's parameters: fly longer, or excite more "
                "(experience.excitation_rms)"
            )
        inertia = known.doubtful_inertia(self.regressor, self.most_doubt)
        if inertia:
            raise UnidentifiedError(
                f"experience.excitation_rms: the flight was too calm to tell {', '.join(inertia)}: excite more, or fly "
                "longer (planner.max_time_s)"
            )

    def agent(self, env: Relay, estimate: ChannelEstimate, learned: Learned) -> Agent:
        """The agent that plans with what has been learned, in worlds between the same nodes."""
        assert learned.identified is not None
        model = learned.identified.model(self.regressor, env.vehicle.tau_max.device)
        reactive = self._reactive(env, Mission(env, estimate.channel, self.cost), learned.trim, model)
        settings = PlanSettings(self.node_s, self.replan_s, self.refine, self.guidance.margin_m)
        guard = self._guard(env)
        if isinstance(guard, EnergyGuard):
            braking = guard.mass_upper_kg / (2.0 * guard.brake_force_N)
            settings = replace(settings, braking=braking, separation_m=guard.separation_m)
        return PlannedAgent(model, reactive, env.vehicle.tau_max, env.scenario, settings)

    def _reactive(self, env: Relay, mission: Mission, trim: Tensor, model: VehicleModel) -> GeodesicAgent:
        """Flies by the law along routes."""
        basis, guidance, dt = LinkFrameBasis(mission.cost, list(SCALES)), self.guidance, env.scenario.dt
        near = LinkController(mission.targets.frame, LinearActor(basis, basis.start_weights()[None]), trim)
        router = Router(env.scenario, mission.targets.frame, mission.cost, guidance.margin_m, guidance.map_settings)
        cruise = Cruise(model, mission.cost, env.vehicle.tau_max, dt)
        return GeodesicAgent(near, RouteTracker(env.scenario, router), mission.cost, guidance, dt, cruise)

    @torch.no_grad()
    def fit(self, env: Relay, estimate: ChannelEstimate) -> Agent:
        """Learn, and return the agent."""
        *_, learned = self.learn(env, estimate)
        return self.agent(env, estimate, learned)
