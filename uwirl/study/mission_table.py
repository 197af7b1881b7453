"""A table of missions, one row a policy."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

from uwirl.study.evaluation import Evaluation


def table(rows: Mapping[str, Evaluation], converged: bool | None = None) -> Iterator[str]:
    """Lines of a table of missions, one row a policy, each in its first world.

    Args:
        rows: evaluations by the name of their policy.
        converged: whether learning the last one converged; None if it was not learned.
    """
    width = max(14, *map(len, rows))
    yield (
        f"{'policy':<{width}} {'J':>8} {'t99 (s)':>8} {'capacity (kbit/s)':>19} {'optimum':>8} {'contacts':>8} "
        f"{'clear (m)':>9} {'blocked':>7} {'guard acts':>14} {'converged':>9}"
    )
    for k, (name, evaluation) in enumerate(rows.items(), 1):
        mission, t99 = evaluation.metrics(), evaluation.time_to_99_percent()
        first, last = (float(evaluation.chain_capacity[step, 0]) for step in (0, -1))
        clearance, acts = mission["min_obstacle_clearance_m"], mission["guard_interventions"]
        clear = "-" if clearance == math.inf else f"{clearance:.2f}"
        guard = "-" if acts is None else f"{acts} ({mission['guard_intervention_share']:.1%})"
        learned = "-" if converged is None or k < len(rows) else "yes" if converged else "no"
        yield (
            f"{name:<{width}} {float(evaluation.cost[0]):>8.3f} {'never' if t99 is None else f'{t99:.2f}':>8} "
            f"{f'{first:.3f} -> {last:.3f}':>19} {evaluation.optimal_capacity:>8.3f} {mission['collisions']:>8} "
            f"{clear:>9} {mission['blocked']:>7} {guard:>14} {learned:>9}"
        )
