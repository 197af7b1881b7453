"""The short table at the end of a run."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from uwirl.study.evaluation import Evaluation


def table(rows: Mapping[str, Evaluation]) -> Iterator[str]:
    """Lines of a table of missions, one row a policy."""
    yield f"{'policy':<14} {'J':>8} {'t99 (s)':>8} {'capacity, start -> end (kbit/s)':>32} {'optimum':>8}"
    for name, evaluation in rows.items():
        t99 = evaluation.time_to_99_percent()
        first, last = (float(evaluation.chain_capacity[k, 0]) for k in (0, -1))
        flown = f"{first:.3f} -> {last:.3f}"
        yield (
            f"{name:<14} {float(evaluation.cost[0]):>8.3f} {'never' if t99 is None else f'{t99:.2f}':>8} "
            f"{flown:>32} {evaluation.optimal_capacity:>8.3f}"
        )
