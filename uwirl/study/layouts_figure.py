"""Figure of missions in random layouts; needs matplotlib (extra `plot`)."""

from __future__ import annotations

from dataclasses import replace

import torch
from matplotlib.figure import Figure
from torch import Tensor

from uwirl.study import style
from uwirl.study.evaluation import Evaluation
from uwirl.study.plan_view import draw_plan
from uwirl.world.layouts import KINDS
from uwirl.world.relay import Relay

COLUMNS = 4


@style.paper
def layouts_figure(env: Relay, evaluation: Evaluation, kind: Tensor) -> Figure:
    """Missions in random layouts from above, four of each kind.

    Args:
        env: the worlds flown.
        evaluation: evaluation of these worlds.
        kind: kind of each world, index into KINDS.
    """
    kind = kind[: env.worlds]
    kinds = kind.unique().tolist()
    side = style.PAGE / COLUMNS
    figure = style.new(style.PAGE, (side + 0.1) * len(kinds))
    # One scale for all, so that layouts can be compared.
    panels = figure.subplots(len(kinds), COLUMNS, squeeze=False, sharex=True, sharey=True)
    for row, k in zip(panels, kinds, strict=True):
        worlds = (kind == k).nonzero()[:COLUMNS, 0].tolist()
        for axes, world in zip(row, worlds, strict=False):
            scenario = env.scenario.worlds(torch.tensor([world]))
            scenario = replace(scenario, obstacles=scenario.obstacles.each(lambda field: field[0]))
            draw_plan(axes, scenario, evaluation.trajectory.eta[:, world].numpy(force=True), arrows=0)
            axes.set_title(f"{KINDS[k].replace('_', ' ')}: {_fate(evaluation, world)}")
            axes.label_outer()
        for axes in row[len(worlds) :]:
            axes.set_visible(False)
    return figure


def _fate(evaluation: Evaluation, world: int) -> str:
    if bool(evaluation.blocked[world].any()):
        return "blocked"
    t99 = evaluation.time_to_99_percent(world)
    return "not reached" if t99 is None else f"{t99:.0f} s"
