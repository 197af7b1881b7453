"""Names, types, units and rules of the world's settings: scenario, vehicle, channel."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

from omegaconf import MISSING

from uwirl.config.checks import (
    MadeConfig,
    Section,
    at_least,
    between,
    beyond_zero,
    finite,
    in_steps,
    not_negative,
    numbers,
    positive,
    ruled,
    valid_seed,
)

# Those of uwirl.world, which needs torch; tests compare them.
LayoutKind = StrEnum("LayoutKind", ["sparse", "random", "overlapping", "dead_end", "ring", "moving"])
Absorption = StrEnum("Absorption", ["none", "thorp", "francois_garrison", "fisher_simmons"])


@dataclass
class ObstacleConfig(Section):
    center_m: list[float] = ruled(numbers(2))  # m; [x, y] of a vertical cylinder's axis
    radius_m: float = ruled(positive)  # m; of the cylinder
    influence_m: float = MISSING  # m; from the axis, where the avoidance term of the cost begins
    velocity_mps: list[float] = ruled(numbers(2), [0.0, 0.0])  # m/s; [x, y] of a drifting cylinder

    def problems(self) -> Iterator[tuple[str, str]]:
        if not self.influence_m > self.radius_m:
            yield "influence_m", f"must exceed radius_m = {self.radius_m:g}"


@dataclass
class LayoutsConfig(Section):
    """Random layouts that what was learned is judged in, instead of the scenario's own start and obstacles."""

    count: int = ruled(at_least(1))  # how many worlds
    seed: int = ruled(valid_seed)  # of the layouts, apart from that of the run
    kinds: list[LayoutKind] = MISSING  # taken in turn
    half_width_m: float = ruled(positive, 30.0)  # m; of the square around the targets in which vehicles start
    current_mps: float = ruled(not_negative, 0.0)  # m/s; of a constant current from another side in each world

    def problems(self) -> Iterator[tuple[str, str]]:
        if not self.kinds:
            yield "kinds", f"needs at least one of {', '.join(LayoutKind)}"


@dataclass
class NavigationConfig(Section):
    """Standard deviations; all zero is a vehicle that knows its pose exactly."""

    position_m: float = ruled(not_negative, 0.0)  # m; of each reading of x, y, z
    yaw_rad: float = ruled(not_negative, 0.0)  # rad; of each reading of the yaw
    velocity_mps: float = ruled(not_negative, 0.0)  # m/s; of each reading of u, v, w
    yaw_rate_rad_s: float = ruled(not_negative, 0.0)  # rad/s; of each reading of r
    drift_mps: float = ruled(not_negative, 0.0)  # m/s; of the velocity at which the horizontal position drifts away


@dataclass
class ScenarioConfig(Section):
    source_m: list[float] = ruled(numbers(3))  # m; [x, y, z] of the node that sends, z up, 0 at the surface
    destination_m: list[float] = ruled(numbers(3))  # m; [x, y, z] of the node that receives
    # Not list[list[float]], which would refuse [0, 0, -5, 1].
    start: list[Any] = MISSING  # eta of each vehicle, [x, y, z, psi] in m and rad, in chain order from the source
    vehicles: int | None = ruled(at_least(1), None)  # how many, spread beside the link in the place of start, or null
    sensors: Any = MISSING  # a number, spread by the seed, or a list of [x, y, z] in m
    obstacles: list[ObstacleConfig] = field(default_factory=list)  # standing or drifting cylinders
    layouts: LayoutsConfig | None = None  # random worlds to be judged in, or null for this one alone
    hearing_range_m: float = ruled(beyond_zero)  # m; of acoustic messages, .inf for all
    message_period_s: float = MISSING  # s; between messages, each of which every sensor in range reads
    detection_range_m: float = ruled(beyond_zero)  # m; from hull to hull; .inf where the map is known
    current_mps: list[float] = ruled(numbers(3))  # m/s; mean of the ocean current, inertial [x, y, z]
    current_std_mps: float = ruled(not_negative)  # m/s; of its Gauss-Markov part, each horizontal component
    current_time_s: float = ruled(positive)  # s; correlation time of that part
    depth_m: float = ruled(positive)  # m; of the water: vehicles stay in -depth_m <= z <= 0
    vehicle_radius_m: float = ruled(positive)  # m; of the sphere around a vehicle that touches nothing
    dt_s: float = ruled(positive)  # s; step of control and of integration (RK4)
    duration_s: float = MISSING  # s; of the mission that is evaluated
    navigation: NavigationConfig = field(
        default_factory=lambda: NavigationConfig()
    )  # how well vehicles know their pose
    streaming: bool = False  # whether vehicles go on to read their links' SNR in flight, at each message

    def problems(self) -> Iterator[tuple[str, str]]:
        if math.dist(self.source_m, self.destination_m) < 1e-6:
            yield "destination_m", "coincides with scenario.source_m: the link has no length"
        if not self.start:
            yield "start", "needs at least one vehicle [x, y, z, psi]"
        for i, eta in enumerate(self.start):
            problem = numbers(4)(eta)
            if problem:
                yield f"start.{i}", problem
            for name, position in self._nodes(i).items():
                if math.dist(eta[:3], position) < 1e-6:
                    yield f"start.{i}", f"{eta[:3]} coincides with {name}, where the SNR is infinite; move it away"
        for key, places in (
            ("source_m", [self.source_m]),
            ("destination_m", [self.destination_m]),
            ("start", self.start),
        ):
            for place in places:
                if not -self.depth_m <= place[2] <= 0.0:
                    water = f"-{self.depth_m:g} <= z <= 0 (scenario.depth_m)"
                    yield key, f"{place[:3]} is not in the water, {water}"
        for key in ("duration_s", "message_period_s"):
            problem = in_steps(getattr(self, key), self.dt_s)
            if problem:
                yield key, problem
        yield from self._problems_of_sensors()

    def _problems_of_sensors(self) -> Iterator[tuple[str, str]]:
        sensors = self.sensors
        number = isinstance(sensors, int) and not isinstance(sensors, bool)
        if not number and not isinstance(sensors, list):
            yield "sensors", f"must be a number or a list of positions [x, y, z], got {sensors!r}"
        count = sensors if number else len(sensors)
        if count < 3:
            yield "sensors", f"{count} sensors cannot determine K, n and the fading: at least 3 are needed"
        if number:
            return
        for j, sensor in enumerate(sensors):
            problem = numbers(3)(sensor)
            if problem:
                yield f"sensors.{j}", problem
            for name, position in self._nodes(len(self.start)).items():
                if math.dist(position, sensor) < 1e-6:
                    yield f"sensors.{j}", f"lies on {name}, where the SNR is infinite; move it away"
        for i, eta in enumerate(self.start):
            distances = [math.dist(eta[:3], sensor) for sensor in sensors]
            if max(distances) / min(distances) < 1.0 + 1e-9:
                all_there = f"all {count} sensors are {distances[0]:g} m from vehicle {i}"
                yield "sensors", f"{all_there}: K and n cannot be told apart from one distance; spread them"

    def _nodes(self, vehicles: int) -> dict[str, list[float]]:
        """Places of the two nodes and of the first few vehicles, m."""
        starts = {f"vehicle {j}": eta[:3] for j, eta in enumerate(self.start[:vehicles])}
        return {"the source": self.source_m, "the destination": self.destination_m, **starts}


@dataclass
class VehicleConfig(MadeConfig, family="vehicle"):
    target: str | None = "uwirl.world.vehicle.Vehicle"  # package.module.Class; null for uwirl's
    mass_kg: float = ruled(positive)  # kg
    yaw_inertia: float = ruled(positive)  # kg m^2; about the vertical axis
    added_mass: list[float] = ruled(numbers(4, not_negative))  # surge, sway, heave in kg, yaw in kg m^2
    linear_damping: list[float] = ruled(numbers(4, not_negative))  # N s/m, yaw N m s/rad; surge, sway, heave, yaw
    quadratic_damping: list[float] = ruled(numbers(4, positive))  # N s^2/m^2, yaw N m s^2/rad^2
    weight_N: float = ruled(not_negative)  # N; in air
    buoyancy_N: float = ruled(not_negative)  # N; of the displaced water
    # N, N, N, N m; the most that thrusters give in surge, sway, heave, yaw
    tau_max: list[float] = ruled(numbers(4, positive))

    def problems(self) -> Iterator[tuple[str, str]]:
        trim, heave = abs(self.weight_N - self.buoyancy_N), self.tau_max[2]
        if trim >= heave:
            yield "tau_max", f"heave {heave:g} N cannot hold the net weight of {trim:g} N"


@dataclass
class WaterConfig(Section):
    """Read by the absorption laws francois_garrison and, but for salinity and acidity, fisher_simmons."""

    # Where the laws were measured.
    temperature_C: float = ruled(between(-2.0, 35.0), 10.0)  # degrees Celsius, in [-2, 35]
    salinity_ppt: float = ruled(between(0.0, 45.0), 35.0)  # parts per thousand, in [0, 45]
    depth_m: float = ruled(between(0.0, 11_000.0), 0.0)  # m, in [0, 11000]
    pH: float = ruled(between(7.0, 9.0), 8.0)  # acidity, in [7, 9]


@dataclass
class ChannelConfig(MadeConfig, family="channel"):
    target: str | None = "uwirl.world.acoustics.LinkBudget"  # package.module.Class; null for uwirl's
    # dB; the source level in dB re 1 uPa at 1 m, if N0_dB is the noise level in dB re 1 uPa
    K_dB: float = ruled(finite)
    n: float = ruled(positive)  # path loss exponent: the SNR falls by 10 n dB per decade of distance
    N0_dB: float = ruled(finite)  # dB; noise level
    bandwidth_khz: float = ruled(positive)  # kHz; width of the band
    absorption: Absorption = MISSING  # law of absorption
    frequency_khz: float | None = ruled(positive)  # kHz; null with absorption none
    zeta_dB: float = ruled(not_negative)  # dB; standard deviation of shadowing
    varphi_m: float = ruled(positive)  # m; its correlation distance
    rho_dB: float = ruled(not_negative)  # dB; standard deviation of multipath
    water: WaterConfig = field(default_factory=lambda: WaterConfig())  # what the absorption depends on

    def problems(self) -> Iterator[tuple[str, str]]:
        if self.absorption == Absorption.none and self.frequency_khz is not None:
            yield "frequency_khz", "has no effect without absorption; set channel.absorption=thorp too"
        if self.absorption != Absorption.none and self.frequency_khz is None:
            yield "frequency_khz", f"absorption {self.absorption} needs a frequency in kHz"
