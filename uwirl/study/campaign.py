"""An agent in many random layouts: arrivals, contacts, and confidence bounds."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields, replace
from typing import Any

import torch
from scipy import special
from torch import Tensor

from uwirl.study.evaluation import Evaluation, Evaluator, finite
from uwirl.study.progress import bar
from uwirl.world.agent import Agent
from uwirl.world.layouts import KINDS, Layouts
from uwirl.world.obstacles import contacts
from uwirl.world.relay import Relay

# Layouts whose feasibility changes if this clearance is added or removed are not counted, m.
AMBIGUITY = 0.05
CONFIDENCE = 0.95


@dataclass(frozen=True)
class Outcomes:
    """Results in N worlds.

    Attributes:
        kind: index into KINDS, [N].
        feasible: whether every vehicle has a free route, [N].
        ambiguous: whether this depends on a few centimetres, [N].
        collisions: number of contact intervals, [N].
        clearance: smallest clearance, [N], m.
        separation: smallest distance between vehicles, [N], m; infinite for a single one.
        t99: time to 99 % of the best capacity, [N], s; infinite if 99 % were not kept.
        blocked: whether some vehicle found no free route at the end, [N].
        cost: J, [N].
        interventions: number of control steps at which the guard changed tau, [N].
        intervention_share: their share of all steps, [N].
    """

    kind: Tensor
    feasible: Tensor
    ambiguous: Tensor
    collisions: Tensor
    clearance: Tensor
    separation: Tensor
    t99: Tensor
    blocked: Tensor
    cost: Tensor
    interventions: Tensor
    intervention_share: Tensor

    @property
    def counted(self) -> Tensor:
        """[N]."""
        return self.feasible & ~self.ambiguous

    @property
    def reached(self) -> Tensor:
        """[N]."""
        return self.t99.isfinite()

    def of(self, rows: Tensor) -> Outcomes:
        """The outcomes of some worlds, by a mask or numbers."""
        return Outcomes(*(getattr(self, field.name)[rows] for field in fields(self)))

    def metrics(self) -> dict[str, Any]:
        """Entries of metrics.json."""
        counted, closed = self.of(self.counted), self.of(~self.feasible & ~self.ambiguous)
        n, missed = len(counted.kind), int((~counted.reached).sum())
        kinds = {f"reach_rate_{KINDS[k]}": _share(counted.of(counted.kind == k).reached) for k in self._kinds()}
        return {
            "worlds": len(self.kind),
            "worlds_feasible": n,
            "worlds_infeasible": len(closed.kind),
            "worlds_ambiguous": int(self.ambiguous.sum()),
            "reach_rate": _share(counted.reached),
            "miss_rate_upper_95": upper_bound(missed, n),
            **kinds,
            "collisions": int(self.collisions.sum()),
            "worlds_with_collision": int((self.collisions > 0).sum()),
            "collision_rate_upper_95": upper_bound(int((self.collisions > 0).sum()), len(self.kind)),
            "min_obstacle_clearance_m": float(self.clearance.min()),
            "min_vehicle_separation_m": finite(float(self.separation.min())),
            "blocked": int(self.blocked.sum()),
            "blocked_where_infeasible": int(closed.blocked.sum()),
            "blocked_where_feasible": int(counted.blocked.sum()),
            "guard_interventions": int(self.interventions.sum()),
            "guard_intervention_share": float(self.intervention_share.mean()),
            "time_to_99_percent_median_s": finite(float(counted.t99.median())) if n else None,
            "time_to_99_percent_max_s": finite(float(counted.t99.max())) if n else None,
            "cost_total_median": float(counted.cost.median()) if n else None,
        }

    def table(self) -> Iterator[str]:
        """Lines of a table with one row per kind."""
        yield (
            f"{'kind':<12} {'worlds':>6} {'feasible':>8} {'reached':>8} {'missed <':>9} {'contacts':>8} {'hit <':>7} "
            f"{'blocked':>7} {'t99 med':>8} {'max (s)':>7} {'clear (m)':>9} {'guard':>6} {'J med':>7}"
        )
        groups = [(KINDS[k], self.of(self.kind == k)) for k in self._kinds()]
        for name, rows in [*groups, ("all", self)]:
            counted = rows.of(rows.counted)
            n, t99 = len(counted.kind), counted.t99 if len(counted.kind) else torch.tensor([math.nan])
            cost = counted.cost if n else torch.tensor([math.nan])
            missed = upper_bound(int((~counted.reached).sum()), n)
            hit = upper_bound(int((rows.collisions > 0).sum()), len(rows.kind))
            yield (
                f"{name:<12} {len(rows.kind):>6} {n:>8} {int(counted.reached.sum()):>8} {missed:>9.2%} "
                f"{int(rows.collisions.sum()):>8} {hit:>7.2%} {int(rows.blocked.sum()):>7} {float(t99.median()):>8.1f} "
                f"{float(t99.max()):>7.1f} {float(rows.clearance.min()):>9.3f} "
                f"{float(rows.intervention_share.mean()):>6.1%} {float(cost.median()):>7.3f}"
            )

    def _kinds(self) -> list[int]:
        return self.kind.unique().tolist()


def fly(
    env: Relay,
    layouts: Layouts,
    agent_in: Callable[[Relay], Agent],
    evaluator: Evaluator,
    batch: int,
    watch: Callable[[Relay, Evaluation], None] = lambda env, evaluation: None,
) -> Outcomes:
    """Fly one mission in each layout.

    Args:
        env: environment with the random streams of the layouts and their common scenario.
        layouts: N layouts.
        agent_in: function of an environment with some of the worlds, returns the agent.
        evaluator: evaluator of the environment.
        batch: number of worlds flown together.
        watch: called after every batch with its results.
    """
    common = replace(env.scenario, start=layouts.start, obstacles=layouts.obstacles)
    everywhere = env.on(common, env.streams)
    parts: list[dict[str, Tensor]] = []
    batches = torch.arange(len(layouts.kind), device=layouts.kind.device).split(batch)
    with bar("flying", len(layouts.kind) * env.scenario.steps, evaluator.progress) as progress:
        for rows in batches:
            worlds = everywhere.select(rows)
            evaluation = evaluator.in_worlds(worlds).fly(agent_in(worlds), progress=progress)
            watch(worlds, evaluation)
            parts.append(_results(evaluation))
    room = env.scenario.vehicle_radius + getattr(evaluator.guard, "margin_m", 0.0)
    verdicts = [
        layouts.feasible(evaluator.mission.targets.frame.target, room + d) for d in (0.0, AMBIGUITY, -AMBIGUITY)
    ]
    joined = {name: torch.cat([part[name] for part in parts]) for name in parts[0]}
    return Outcomes(layouts.kind, verdicts[0], verdicts[1] != verdicts[2], **joined)


def _results(evaluation: Evaluation) -> dict[str, Tensor]:
    """Fields of Outcomes that are known of each world flown."""
    interventions = evaluation.interventions
    assert interventions is not None
    return {
        "collisions": contacts(evaluation.clearance).sum(-1),
        "clearance": evaluation.clearance.amin((0, 2)),
        "separation": evaluation.separation.double(),
        "t99": evaluation.arrival,
        "blocked": evaluation.blocked.any(-1),
        "cost": evaluation.cost,
        "interventions": interventions,
        "intervention_share": interventions.double() / len(evaluation.saturated),
    }


def upper_bound(failures: int, trials: int) -> float:
    """Clopper-Pearson: the rate at which this many failures or fewer have a probability of 5 %; nan without trials."""
    if trials == 0:
        return math.nan
    return 1.0 if failures == trials else float(special.betaincinv(failures + 1, trials - failures, CONFIDENCE))


def _share(flags: Tensor) -> float | None:
    return float(flags.double().mean()) if len(flags) else None
