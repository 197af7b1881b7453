"""What a second process gains: an ablation sweep of 20 jobs by the joblib launcher, with one and with two processes.

    python benchmarks/sweep.py            # --seeds 1: only 4 jobs

Times are those of a clock on the wall, starting Python included, so other work on the machine counts. Results must
agree to the last digit.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

ABLATIONS = ("none", "no_shadowing", "no_multipath", "least_squares")
SETTINGS = ("experiment=fig5_free", "logging.figures=false", "logging.tensorboard=false", "logging.progress=false")


def sweep(seeds: int, processes: int, folder: Path) -> float:
    """Run it; returns seconds.

    Raises:
        subprocess.CalledProcessError: a job failed.
    """
    swept = [f"ablation={','.join(ABLATIONS)}", f"seed=range({seeds})", f"hydra.sweep.dir={folder}"]
    launcher = ["hydra/launcher=joblib", f"hydra.launcher.n_jobs={processes}"]
    begin = time.perf_counter()
    subprocess.run(
        [sys.executable, "-m", "uwirl.apps.run", "-m", *SETTINGS, *swept, *launcher], check=True, stdout=subprocess.PIPE
    )
    return time.perf_counter() - begin


def results(folder: Path) -> dict[str, dict[str, Any]]:
    """metrics.json of each job but for its time."""
    found = {path.parent.name: json.loads(path.read_text()) for path in folder.glob("*/metrics.json")}
    return {name: {k: v for k, v in job.items() if k != "wall_time_s"} for name, job in found.items()}


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--seeds", type=int, default=5)
    seeds: int = parser.parse_args().seeds
    with tempfile.TemporaryDirectory() as temporary:
        one, two = Path(temporary) / "one", Path(temporary) / "two"
        alone, together = sweep(seeds, 1, one), sweep(seeds, 2, two)
        if results(one) != results(two):
            sys.exit("the two sweeps differ")
        jobs = len(results(one))
    print(f"{'processes':<10} {'jobs':>5} {'s':>8} {'s a job':>8}")
    for processes, seconds in ((1, alone), (2, together)):
        print(f"{processes:<10} {jobs:>5} {seconds:>8.1f} {seconds / jobs:>8.2f}")
    print(f"one against two: {alone / together:.2f}")


if __name__ == "__main__":
    main()
