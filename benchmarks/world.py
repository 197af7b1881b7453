"""How fast the vehicle dynamics run: one RK4 step of the 4-DOF model with held tau, on one thread or a GPU.

    python benchmarks/world.py
    python benchmarks/world.py --device cuda    # 10,000 to 10,000,000 worlds
    python benchmarks/world.py --against PATH    # rollouts and the guard beside those of another checkout, instead

Every rate is in vehicle-steps per second of one core or of the GPU. Beside eager and compiled PyTorch stand two
yardsticks, measured in the same run: the model hand-written for one vehicle in plain Python (on a CPU), and the copy
bandwidth of the machine. A step must at
least read x (8 numbers) and tau (4) and write x (8), so no implementation whose state lies in memory exceeds

    bound = bandwidth / (20 * itemsize).

Steps are chained as in a rollout. Eager ones write into memory that is there already, as `Relay.rollout` does; compiled
ones return a new tensor, so that at 1,000,000 worlds page faults of the allocator are part of their cost.
"""

from __future__ import annotations

import argparse
import itertools
import json
import math
import os
import platform
import re
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from uwirl.config.compose import compose
from uwirl.config.schema import VehicleConfig
from uwirl.world.vehicle import Vehicle, VehicleState

DT = 0.05  # s
WORLDS = {"cpu": (1, 100, 10_000, 100_000, 1_000_000), "cuda": (10_000, 1_000_000, 10_000_000)}
DTYPES = {"float32": torch.float32, "float64": torch.float64}
NUMBERS_MOVED = 8 + 4 + 8
COPY_BYTES = 256 * 2**20
ROUNDS = 9
SECONDS = 0.12  # of each measurement in each round

# What is measured: dtype, worlds, mode.
Key = tuple[str, int, str]
COPY: Key = ("bytes", COPY_BYTES, "copy")
SCALAR: Key = ("float64", 1, "scalar")


@dataclass(frozen=True)
class Workload:
    """Something to time.

    Attributes:
        advance: maps a state to the next one.
        start: the first state.
        size: work done by one call, in vehicle-steps (in bytes for the copy).
    """

    advance: Callable[[Any], Any]
    start: Any
    size: int

    def rate(self, seconds: float) -> float:
        """Work per second, measured over at least one call and about the given time in s."""
        state = self.advance(self.start)  # untimed: brings code and data into the caches
        wait()
        calls, begin = 0, time.perf_counter()
        while time.perf_counter() - begin < seconds:
            state = self.advance(state)
            calls += 1
        wait()
        return calls * self.size / (time.perf_counter() - begin)


def wait() -> None:
    """Until a GPU, if one is used, has done what it was given."""
    if torch.cuda.is_initialized():
        torch.cuda.synchronize()


class ScalarVehicle:
    """The model of `Vehicle` for one vehicle, as one would write it by hand: Python floats, one equation a line."""

    def __init__(self, config: VehicleConfig):
        rigid = [config.mass_kg, config.mass_kg, config.mass_kg, config.yaw_inertia]
        self.inertia = [r + a for r, a in zip(rigid, config.added_mass, strict=True)]
        self.linear, self.quadratic = list(config.linear_damping), list(config.quadratic_damping)
        self.restoring = [0.0, 0.0, config.weight_N - config.buoyancy_N, 0.0]

    def derivative(self, x: list[float], tau: list[float]) -> list[float]:
        """Right-hand side of M nu_dot + C(nu) nu + D(nu) nu + g = tau and of eta_dot = J(psi) nu; x is eta, nu."""
        psi, nu = x[3], x[4:]
        u, v, w, r = nu
        c, s = math.cos(psi), math.sin(psi)
        m_u, m_v = self.inertia[0], self.inertia[1]
        coriolis = [-m_v * v * r, m_u * u * r, 0.0, (m_v - m_u) * u * v]
        nu_dot = []
        for i in range(4):
            damping = (self.linear[i] + self.quadratic[i] * abs(nu[i])) * nu[i]
            nu_dot.append((tau[i] - coriolis[i] - damping - self.restoring[i]) / self.inertia[i])
        return [c * u - s * v, s * u + c * v, w, r, *nu_dot]

    def step(self, x: list[float], tau: list[float], dt: float) -> list[float]:
        """x after dt (s) by classical Runge-Kutta with tau held."""
        k1 = self.derivative(x, tau)
        k2 = self.derivative([a + dt / 2 * k for a, k in zip(x, k1, strict=True)], tau)
        k3 = self.derivative([a + dt / 2 * k for a, k in zip(x, k2, strict=True)], tau)
        k4 = self.derivative([a + dt * k for a, k in zip(x, k3, strict=True)], tau)
        return [x[i] + dt / 6 * (k1[i] + 2 * k2[i] + 2 * k3[i] + k4[i]) for i in range(8)]


def draw(worlds: int, dtype: torch.dtype, device: str = "cpu") -> tuple[VehicleState, Tensor]:
    """A random state of so many worlds with one vehicle each, and a random tau [worlds, 1, 4]."""
    state = VehicleState(torch.randn(8, worlds, 1, dtype=dtype, device=device) * 0.3)
    return state, torch.randn(4, worlds, 1, dtype=dtype, device=device).movedim(0, -1)


def scalar_workload(config: VehicleConfig) -> Workload:
    """The hand-written vehicle, checked against `Vehicle.step` on 100 vehicles over 20 steps."""
    vehicle, scalar = Vehicle(**config.values()), ScalarVehicle(config)
    state, tau = draw(100, torch.float64)
    forces: list[list[float]] = tau[:, 0].tolist()
    singles: list[list[float]] = state.components[..., 0].T.tolist()
    start = singles[0]
    for _ in range(20):
        state = vehicle.step(state, tau, DT)
        singles = [scalar.step(x, force, DT) for x, force in zip(singles, forces, strict=True)]
        expected = torch.tensor(singles, dtype=torch.float64).T
        torch.testing.assert_close(state.components[..., 0], expected, rtol=0.0, atol=1e-12)
    return Workload(lambda x: scalar.step(x, forces[0], DT), start, 1)


def eager_workload(vehicle: Vehicle, state: VehicleState, tau: Tensor) -> Workload:
    """`Vehicle.step`, which takes a large batch in chunks by itself, writing into two states in turn."""
    memory = itertools.cycle([torch.zeros_like(state.components) for _ in range(2)])
    return Workload(lambda s: vehicle.step(s, tau, DT, out=next(memory)), state, len(tau))


def compiled_workload(
    rk4: Callable[[Tensor, Tensor], Tensor], vehicle: Vehicle, state: VehicleState, tau: Tensor
) -> Workload:
    """Compiled `Vehicle.rk4` on [8, worlds], called once and checked against the eager step.

    Raises:
        RuntimeError: this machine cannot compile.
    """
    x, force = state.components[..., 0], tau[:, 0].T
    torch.testing.assert_close(rk4(x, force), vehicle.step(state, tau, DT).components[..., 0])
    return Workload(lambda s: rk4(s, force), x, len(tau))


def vehicle_workloads(config: VehicleConfig, device: str) -> dict[Key, Workload]:
    """Every size and dtype, eager and, where this machine has a compiler, compiled."""
    found: dict[Key, Workload] = {}
    can_compile = True
    for name, dtype in DTYPES.items():
        vehicle = Vehicle(**config.values(), dtype=dtype, device=device)

        def rk4(x: Tensor, tau: Tensor, vehicle: Vehicle = vehicle) -> Tensor:
            return vehicle.rk4(x, tau, DT)

        # One kernel for all sizes above one: as fast as a kernel for each, and what a user with varying batches has.
        compiled = torch.compile(rk4, dynamic=True)
        for worlds in WORLDS[device]:
            state, tau = draw(worlds, dtype, device)
            found[name, worlds, "eager"] = eager_workload(vehicle, state, tau)
            if can_compile:
                try:
                    found[name, worlds, "compiled"] = compiled_workload(compiled, vehicle, state, tau)
                except RuntimeError as error:
                    can_compile = False
                    print(f"compiled column skipped: {str(error).strip().splitlines()[0]}")
    return found


def measure(workloads: dict[Key, Workload]) -> dict[Key, list[float]]:
    """The rates of each workload, one a round; interleaved, so that drift of the machine falls on all alike."""
    rates: dict[Key, list[float]] = {key: [] for key in workloads}
    for _ in range(ROUNDS):
        for key, workload in workloads.items():
            rates[key].append(workload.rate(SECONDS))
    return rates


def ratio(over: list[float], under: list[float]) -> float:
    """Median of the ratios within rounds."""
    return statistics.median(a / b for a, b in zip(over, under, strict=True))


def cells(rates: dict[Key, list[float]], key: Key) -> str:
    """Median, range and share of the copy bound, for the table; blank where not measured."""
    if key not in rates:
        return f"{'-':>9}  {'-':>17}  {'-':>9}"
    million = [rate / 1e6 for rate in rates[key]]
    spread = f"{min(million):.3g} - {max(million):.3g}"
    bytes_moved = NUMBERS_MOVED * DTYPES[key[0]].itemsize
    share = 100.0 * bytes_moved * ratio(rates[key], rates[COPY])
    return f"{statistics.median(million):>9.3g}  {spread:>17}  {share:>8.2g}%"


def report(rates: dict[Key, list[float]], device: str) -> None:
    """Print the table and the ratios."""
    bandwidth = statistics.median(rates[COPY])
    spread = f"{min(rates[COPY]) / 1e9:.3g} - {max(rates[COPY]) / 1e9:.3g}"
    print(f"\ncopy bandwidth, read + write: {bandwidth / 1e9:.3g} GB/s ({spread})")
    for name, dtype in DTYPES.items():
        bound = bandwidth / (NUMBERS_MOVED * dtype.itemsize)
        print(f"bound that it sets, {name}: {bound / 1e6:.0f} million vehicle-steps/s")
    unit = "core-second" if device == "cpu" else "second"
    print(f"\nmillion vehicle-steps per {unit}: median (min - max of {ROUNDS} rounds), share of the bound\n")
    column = f"{'median':>9}  {'min - max':>17}  {'share':>9}"
    print(f"{'':7}  {'':>9}  {'eager':>39}  {'compiled':>39}")
    print(f"{'dtype':7}  {'worlds':>9}  {column}  {column}")
    for name in DTYPES:
        for worlds in WORLDS[device]:
            row = "  ".join(cells(rates, (name, worlds, mode)) for mode in ("eager", "compiled"))
            print(f"{name:7}  {worlds:>9,}  {row}")
    if SCALAR in rates:
        print(f"{'scalar':7}  {'1':>9}  {cells(rates, SCALAR)}")
    print()
    comparisons: dict[str, tuple[Key, Key]] = {
        "compiled / eager, float32, 10,000": (("float32", 10_000, "compiled"), ("float32", 10_000, "eager")),
        "compiled / eager, float32, 1,000,000": (("float32", 1_000_000, "compiled"), ("float32", 1_000_000, "eager")),
        "eager float32, 1,000,000 / 100,000": (("float32", 1_000_000, "eager"), ("float32", 100_000, "eager")),
        "eager float32, 100,000 / scalar": (("float32", 100_000, "eager"), SCALAR),
        "eager float64, 100,000 / scalar": (("float64", 100_000, "eager"), SCALAR),
    }
    for label, (over, under) in comparisons.items():
        if over in rates and under in rates:
            print(f"{label:36}{ratio(rates[over], rates[under]):>8.3g}")


def processor() -> str:
    """Name of the CPU model, as far as the system tells."""
    info = Path("/proc/cpuinfo")
    match = re.search(r"^model name\s*:\s*(.+)$", info.read_text(), re.MULTILINE) if info.exists() else None
    return match.group(1) if match else platform.processor() or platform.machine()


def flights(checkouts: dict[str, Path]) -> dict[str, dict[str, float]]:
    """Nanoseconds a vehicle-step of rollouts and the guard: the least of rounds that alternate between checkouts.

    Raises:
        SystemExit: a checkout's process ended.
    """
    command = [sys.executable, str(Path(__file__).with_name("flights.py"))]
    processes = {
        name: subprocess.Popen(
            command,
            env=os.environ | {"PYTHONPATH": str(path)},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        for name, path in checkouts.items()
    }
    least: dict[str, dict[str, float]] = {name: {} for name in checkouts}
    for _ in range(ROUNDS):
        for name, process in processes.items():
            assert process.stdin is not None
            assert process.stdout is not None
            print(file=process.stdin, flush=True)
            line = process.stdout.readline()
            if not line:
                raise SystemExit(f"{name} ({checkouts[name]}) ended before it was measured")
            for call, time_ns in json.loads(line).items():
                least[name][call] = min(time_ns, least[name].get(call, math.inf))
    for process in processes.values():
        process.communicate()
    return least


def versions(against: Path) -> None:
    """Print this version beside another one."""
    least = flights({"this": Path(__file__).parents[1], "other": against.resolve()})
    print(f"{'ns a vehicle-step':<34} {'this':>12} {'other':>12} {'this / other':>13}")
    for call, this in least["this"].items():
        print(f"{call:<34} {this:>12.1f} {least['other'][call]:>12.1f} {this / least['other'][call]:>13.2f}")


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--against", type=Path, help="root of another checkout")
    parser.add_argument("--device", choices=tuple(WORLDS), default="cpu")
    arguments = parser.parse_args()
    against: Path | None = arguments.against
    device: str = arguments.device
    if device == "cuda" and not torch.cuda.is_available():
        parser.error("--device cuda: no CUDA device that this PyTorch can use")
    torch.set_num_threads(1)
    torch.manual_seed(0)
    machine = f"{processor()}, one thread" if device == "cpu" else torch.cuda.get_device_name()
    print(f"{machine}; torch {torch.__version__}, Python {platform.python_version()}", flush=True)
    if against is not None:
        versions(against)
        return
    config = compose([]).vehicle
    source, target = torch.ones(2, COPY_BYTES, dtype=torch.uint8, device=device)
    with torch.inference_mode():
        workloads = vehicle_workloads(config, device)
        if device == "cpu":
            workloads[SCALAR] = scalar_workload(config)
        workloads[COPY] = Workload(lambda _: target.copy_(source), None, 2 * COPY_BYTES)
        report(measure(workloads), device)


if __name__ == "__main__":
    main()
