"""planner=identified: a model of the vehicle learned from a minute of its flight, and optimal flights on that model."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import torch
from torch import Tensor

from uwirl.irl.networks import LinearActor
from uwirl.motion.calibration import calibration_hover
from uwirl.motion.cost import CostWeights
from uwirl.motion.cruise import Cruise
from uwirl.motion.experience import Exploration, VirtualLinks, contacts_while
from uwirl.motion.features import LinkFrameBasis
from uwirl.motion.guidance import Geodesic, GeodesicAgent
from uwirl.motion.identification import Identified, Log, Windows, identify_flights
from uwirl.motion.linear_agent import LinearAgent, LinkController, LinkView
from uwirl.motion.mission import Mission
from uwirl.motion.planned_agent import PlannedAgent, PlanSettings
from uwirl.motion.route import Router
from uwirl.motion.route_tracker import RouteTracker
from uwirl.motion.safety import EnergyGuard, Limits
from uwirl.motion.vehicle_model import Fossen, Regressor
from uwirl.snr.estimate import ChannelEstimate
from uwirl.world.agent import Agent, Guard, Guarded
from uwirl.world.relay import Relay

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
    """

    identified: Identified | None
    trim: Tensor
    seconds: float
    contacts: int


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
    node_s: float = 0.1
    replan_s: float = 2.0
    refine: int = 2
    regressor: Regressor = field(default_factory=Fossen)

    def learn(self, env: Relay, estimate: ChannelEstimate) -> Iterator[Learned]:
        """Hover, then fly to virtual links with excitation; yields what is known after each leg.

        Raises:
            UnidentifiedError: the inertia remains in doubt at the end.
        """
        mission, guard = Mission(env, estimate.channel, self.cost), self._guard(env)
        basis = LinkFrameBasis(mission.cost, list(SCALES))
        actor = LinearActor(basis, basis.start_weights()[None])
        hover, trim = calibration_hover(env, actor, mission.cost, self.calibration_s, guard)
        trim = trim.mean(0)
        dt, vehicles = env.scenario.dt, env.worlds * env.scenario.vehicles
        steps = round(self.window_s / dt)
        windows = Windows(self.regressor, dt, steps, steps, env.scenario.depth)
        logs, world, leg = [Log.of(hover)], hover.end.detached(), 0
        hit, seconds = contacts_while(env, hover), float(hover.time[-1])
        current = trim.new_zeros(2).double()
        poses = self.experience.poses(env.scenario, bool(env.scenario.obstacles.number))
        while True:
            # A hover alone tells neither drag nor current.
            known = identify_flights(windows, logs, env.vehicle.tau_max, current) if leg else None
            current = current if known is None else known.current
            yield Learned(known, trim, seconds * vehicles, hit)
            if seconds >= self.max_time_s:
                break
            legs = round(self.experience.leg_s / dt)
            view = LinkView(poses.frame(env, world.vehicles.eta, leg))
            wave = self.experience.excitation.draw(env.streams, env.scenario.vehicles, leg, legs, dt)
            wave = wave.to(trim).view(legs, *world.vehicles.eta.shape)
            agent = LinearAgent(view, actor, trim, wave.to(world.vehicles.eta), int(world.step[0]))
            flown = env.rollout(Guarded(agent, guard), world, legs)
            logs.append(Log.of(flown))
            hit, seconds = hit + contacts_while(env, flown), seconds + self.experience.leg_s
            world, leg = flown.end.detached(), leg + 1
        self._check(known)

    def _guard(self, env: Relay) -> Guard:
        return self.guard or EnergyGuard(Limits.of(env))

    def _check(self, known: Identified | None) -> None:
        if known is None:
            raise UnidentifiedError("planner.max_time_s: too short a flight for the model's parameters")
        inertia = known.doubtful_inertia(self.regressor, self.most_doubt)
        if inertia:
            raise UnidentifiedError(
                f"experience.excitation_rms: the flight was too calm to tell {', '.join(inertia)}: excite more, or fly "
                "longer (planner.max_time_s)"
            )

    def agent(self, env: Relay, estimate: ChannelEstimate, learned: Learned) -> Agent:
        """The agent that plans with what has been learned, in worlds between the same nodes."""
        assert learned.identified is not None
        mission = Mission(env, estimate.channel, self.cost)
        device = env.vehicle.tau_max.device
        basis = LinkFrameBasis(mission.cost, list(SCALES))
        near = LinkController(mission.targets.frame, LinearActor(basis, basis.start_weights()[None]), learned.trim)
        guidance = self.guidance
        router = Router(env.scenario, mission.targets.frame, mission.cost, guidance.margin_m, guidance.map_settings)
        tracker = RouteTracker(env.scenario, router)
        model = learned.identified.model(self.regressor, device)
        cruise = Cruise(model, mission.cost, env.vehicle.tau_max, env.scenario.dt)
        reactive = GeodesicAgent(near, tracker, mission.cost, guidance, env.scenario.dt, cruise)
        settings = PlanSettings(self.node_s, self.replan_s, self.refine, guidance.margin_m)
        guard = self._guard(env)
        if isinstance(guard, EnergyGuard):
            braking = guard.mass_upper_kg / (2.0 * guard.brake_force_N)
            settings = replace(settings, braking=braking, separation_m=guard.separation_m)
        return PlannedAgent(model, reactive, env.vehicle.tau_max, env.scenario, settings)

    @torch.no_grad()
    def fit(self, env: Relay, estimate: ChannelEstimate) -> Agent:
        """Learn, and return the agent."""
        *_, learned = self.learn(env, estimate)
        return self.agent(env, estimate, learned)
