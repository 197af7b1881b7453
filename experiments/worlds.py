"""Links from 0.5 m to 10 km, flat to vertical, with 1 to 10 vehicles: each is flown, or refused before anything runs.

    python experiments/worlds.py
    python experiments/worlds.py "overrides=['planner=irl']" 'only=[0,24,49]'

Every world is a command `uwirl` of its own, whose time and peak memory are measured.
"""

from __future__ import annotations

import json
import logging
import math
import os
import random
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import hydra
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig
from results import leave

log = logging.getLogger("uwirl")

SHORTEST_M, LONGEST_M = 0.5, 1e4
INCLINATIONS = (0.0, 90.0, 30.0, 75.0, 10.0, 85.0, 45.0, 60.0, 0.0, 90.0)  # degrees
VEHICLES = (1, 2, 1, 3, 1, 10, 1, 5, 2, 1, 7)
SLOW_MPS = 0.7  # at which durations are long enough
APART_M = 1.5  # between starts
FARTHEST_M = 300.0  # of starts from the link


class World(NamedTuple):
    """A relay problem.

    Attributes:
        length: of the link, m.
        inclination: of the link to the horizontal, degrees.
        vehicles: their number.
        overrides: as on the command line.
    """

    length: float
    inclination: float
    vehicles: int
    overrides: list[str]


def world(k: int, count: int) -> World:
    """World k of so many, the shortest first."""
    draw = random.Random(k)
    length = SHORTEST_M * (LONGEST_M / SHORTEST_M) ** (k / (count - 1))
    inclination, vehicles = INCLINATIONS[k % len(INCLINATIONS)], VEHICLES[k % len(VEHICLES)]
    rise, run = (length * part(math.radians(inclination)) for part in (math.sin, math.cos))
    # From 0.5 m below the surface to 0.5 m above the floor, or with room.
    room = draw.choice([1.0, 20.0, 100.0])
    depth = rise + room
    top = -draw.choice([0.5, 0.5 * room])
    bearing = draw.uniform(-math.pi, math.pi)
    c, s = math.cos(bearing), math.sin(bearing)
    source, destination = [0.0, 0.0, top], [run * c, run * s, top - rise]
    if draw.random() < 0.5:
        source, destination = destination, source
    hop = length / (vehicles + 1)
    # Beside their targets, near or far, in the order of the chain.
    aside = min(max(draw.choice([0.5, 0.5, 2.0]) * draw.choice([hop, hop, length]), 2.0), FARTHEST_M)
    start, farthest = [], 0.0
    for i in range(vehicles):
        target = [a + (i + 1) / (vehicles + 1) * (b - a) for a, b in zip(source, destination, strict=True)]
        # Along the link, or along the bearing of one that is too steep or short for all.
        shift = (i - 0.5 * (vehicles - 1)) * max(run / (vehicles + 1), APART_M) * (1 if source[2] == top else -1)
        x, y = 0.5 * run * c + c * shift - s * aside, 0.5 * run * s + s * shift + c * aside
        z = max(-depth, min(0.0, target[2] + draw.uniform(-0.1, 0.1) * room))
        start.append([round(v, 3) for v in (x, y, z, draw.uniform(-math.pi, math.pi))])
        farthest = max(farthest, math.dist(start[-1][:3], target))
    obstacles = []
    for _ in range(draw.choice([0, 0, 1, 2]) if length > 20.0 else 0):
        radius = round(draw.uniform(0.5, 0.1 * aside + 0.5), 2)
        along = draw.uniform(0.2, 0.8) * run
        place = [round(c * along - s * 0.5 * aside, 2), round(s * along + c * 0.5 * aside, 2)]
        obstacles.append(f"{{center_m: {place}, radius_m: {radius}, influence_m: {radius + 4.0:g}}}")
    enough = 0.05 * math.ceil((60.0 + farthest / SLOW_MPS) / 0.05)
    duration = 80.0 if draw.random() < 0.2 else enough
    return World(
        length,
        inclination,
        vehicles,
        [
            f"channel={draw.choice(['paper', 'acoustic_24khz'])}",
            f"scenario.source_m={[round(v, 3) for v in source]}",
            f"scenario.destination_m={[round(v, 3) for v in destination]}",
            f"scenario.depth_m={round(depth + 0.001, 3)}",
            f"scenario.start={start}",
            f"scenario.obstacles=[{','.join(obstacles)}]",
            f"scenario.duration_s={duration:.10g}",
        ],
    )


def fly(overrides: Sequence[str], folder: Path) -> dict[str, Any]:
    """Run `uwirl`: what it left, its processor's time in s and its peak memory in MB."""
    folder.mkdir(parents=True)
    command = [sys.executable, "-c", "from uwirl.apps.run import main; main()"]
    with (folder / "terminal.txt").open("w") as terminal:
        process = subprocess.Popen([*command, *overrides, f"hydra.run.dir={folder}"], stdout=terminal, stderr=terminal)
        _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    path = folder / "metrics.json"
    metrics = json.loads(path.read_text()) if path.exists() else {}
    said = (folder / "terminal.txt").read_text().strip().splitlines()
    return {
        "exit": process.returncode,
        "status": metrics.get("status", "no run"),
        "said": (metrics.get("error") or (said[-1] if said else "")) if process.returncode else "",
        "warnings": metrics.get("warnings", []),
        "seconds": usage.ru_utime + usage.ru_stime,
        # Linux counts in KiB.
        "megabytes": usage.ru_maxrss / 1024.0,
        "t99_s": metrics.get("time_to_99_percent_s"),
        "contacts": metrics.get("collisions"),
        "share_of_best": (metrics["capacity_final_mean_kbps"] / metrics["capacity_optimal_mean_kbps"])
        if metrics.get("capacity_optimal_mean_kbps")
        else None,
        "optimum_kbps": metrics.get("capacity_optimal_mean_kbps"),
    }


@hydra.main(config_path="conf", config_name="worlds", version_base="1.3")
def main(settings: DictConfig) -> None:
    """Fly them, and log a line each."""
    folder = Path(HydraConfig.get().runtime.output_dir).absolute()
    rows: list[dict[str, Any]] = []
    head = f"{'':>3} {'length (m)':>10} {'incl.':>5} {'vehicles':>8} {'end':>8} {'t99 (s)':>8} {'contacts':>8}"
    log.info("%s %8s %11s %6s %6s", head, "share", "best kbit/s", "s", "MB")
    for k in settings.only or range(settings.worlds):
        place = world(k, settings.worlds)
        row = fly([*place.overrides, *settings.overrides], folder / f"{k:02d}")
        rows.append({"world": k, **place._asdict(), **row})
        end = {0: "flew", 2: "refused"}.get(row["exit"], "FAILED")
        blank = dict.fromkeys(("t99_s", "contacts", "share_of_best", "optimum_kbps"), "-")
        shown = {name: dash if row[name] is None else str(row[name]) for name, dash in blank.items()}
        log.info(
            "%3d %10.3g %5g %8d %8s %8.5s %8s %8.5s %11.8s %6.1f %6.0f  %s",
            *(k, place.length, place.inclination, place.vehicles, end, shown["t99_s"], shown["contacts"]),
            *(shown["share_of_best"], shown["optimum_kbps"], row["seconds"], row["megabytes"], row["said"][:400]),
        )
    leave({"worlds": rows})


if __name__ == "__main__":
    main()
