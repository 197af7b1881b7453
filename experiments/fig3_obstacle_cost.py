"""Fig. 3: the avoidance term (34), (35) with the printed constants, with Remark 2's, and by default.

    python experiments/fig3_obstacle_cost.py

Drawn for the obstacles of Fig. 5, whose c and nu the paper prints (its own drawing has rho_o = 1.2 m). With its weights
the link outweighs the ring that the printed constants make: level lines bend, but the target stays the only minimum.
From beta_2 = 1.7 on there are minima on the ring, where a vehicle would stay; this shows them:

    python experiments/fig3_obstacle_cost.py "overrides=['experiment=fig5_single','cost=paper','cost.beta_2=3']"

Needs matplotlib (extra `plot`).
"""

from __future__ import annotations

from dataclasses import replace

import hydra
import torch
from matplotlib.axes import Axes
from matplotlib.colors import PowerNorm
from matplotlib.contour import ContourSet
from matplotlib.figure import Figure
from omegaconf import DictConfig
from results import leave, tell
from torch import Tensor

from uwirl import build
from uwirl.config.compose import compose
from uwirl.config.schema import PrintedCostConfig
from uwirl.config.validate import validate
from uwirl.motion.avoidance import Avoidance, Printed, remark_2, smooth
from uwirl.motion.cost import CostWeights, RelayCost
from uwirl.motion.link_frame import LinkFrame
from uwirl.motion.mission import Mission
from uwirl.study import style
from uwirl.study.colours import BLUE, ORANGE
from uwirl.world.scenario import Scenario
from uwirl.world.truth import truth_of
from uwirl.world.vehicle import VehicleState

# Colour, line and name of each form.
STYLES = {
    "printed": (ORANGE, "-", "printed: $c = {c:g}$, $\\nu = {nu:g}$ m"),
    "remark_2": (BLUE, "--", "Remark 2: $c = {c:.1f}$, $\\nu = {nu:.2f}$ m"),
    "default": ("black", ":", "default: $\\max(0, 1/l - 1/\\rho_o)^2$"),
}
TITLES = (
    "(a) cut-off of (35)",
    "(b) avoidance term of (34), one obstacle",
    "(c) state cost from above, printed constants",
    "(d) state cost from above, default",
)
REACH_M = 12.0


def curve(form: Avoidance, l: Tensor, influence: Tensor) -> Tensor:
    """E_O of a single obstacle of radius rho_o [1] at distances l [n], m: [n], 1/m^2."""
    return form(l[:, None], influence)


def cut_off(form: Printed, l: Tensor) -> Tensor:
    """f(l) of (35), [n]: with an infinite rho_o, E_O is f(l) / l^2."""
    return l.square() * curve(form, l, torch.full_like(l[:1], torch.inf))


def ring(form: Avoidance, influence: Tensor) -> tuple[float, float | None]:
    """Largest E_O beyond rho_o, 1/m^2, and the l at which it lies, m; None where E_O is zero."""
    l = torch.linspace(float(influence), 2.0 * REACH_M, 100_001, dtype=influence.dtype)
    height, k = curve(form, l, influence).max(0)
    return float(height), float(l[k]) if height > 0.0 else None


def state_cost(cost: RelayCost, frame: LinkFrame, scenario: Scenario, x: Tensor) -> Tensor:
    """E_L - E_L,min + beta_2 E_O at the target's depth over x [n] and y alike, m: [n, n], y first."""
    eta = torch.zeros(len(x), len(x), 1, 4, dtype=x.dtype)
    eta[..., 0], eta[..., 1], eta[..., 2] = x[:, None], x[:, None, None], frame.target[0, 2]
    link = cost.link(frame.relative(VehicleState.from_eta_nu(eta)))
    return (link + cost.obstacle(scenario.obstacles, eta[..., :3]))[..., 0]


def minima(x: Tensor, q: Tensor) -> Tensor:
    """Points [k, 2], m, of a map q [n, n] over x [n] and y alike that are the lowest within 1 m; none at its edges."""
    # A curved valley that is narrower than the spacing would show false minima among the eight neighbours alone.
    reach = max(1, round(1.0 / float(x[1] - x[0])))
    lowest = -torch.nn.functional.max_pool2d(-q[None], 2 * reach + 1, stride=1)[0]
    return x[reach + (q[reach:-reach, reach:-reach] == lowest).nonzero().flip(-1)]


def draw_curves(cut: Axes, term: Axes, forms: dict[str, Avoidance], cost: PrintedCostConfig, radii: Tensor) -> None:
    """Panels (a) and (b); radii are rho_m and rho_o, [2], m."""
    l = torch.linspace(float(radii[0]), REACH_M, 2001, dtype=radii.dtype)
    for name, form in forms.items():
        colour, line, label = STYLES[name]
        if isinstance(form, Printed):
            label = label.format(c=form.c, nu=form.nu)
            cut.plot(l, cut_off(form, l), line, color=colour, label=label)
        term.plot(l, curve(form, l, radii[1:]), line, color=colour, label=label)
    for name, l_m, kappa in (("A", cost.left_m, cost.kappa_1), ("B", cost.right_m, cost.kappa_2)):
        cut.plot(l_m, kappa, "o", color=STYLES["remark_2"][0], ms=4)
        cut.annotate(f"$P_{name}$", (l_m, kappa), (8.0, 2.0), textcoords="offset points")
    for axes in (cut, term):
        for name, radius in zip("mo", radii.tolist(), strict=True):
            axes.axvline(radius, color="0.5", lw=1.0)
            text = f"$\\rho_{name}$ = {radius:g} m"
            axes.annotate(text, (radius, 1.01), xycoords=("data", "axes fraction"), ha="center")
        axes.set_xlabel("distance to the axis $l$ (m)")
        axes.grid()
    cut.set(ylabel="$f(l)$", ylim=(-0.03, 1.5))
    cut.legend(loc="upper right")
    term.set(ylabel="$E_O$ (1/m$^2$)", yscale="log", ylim=(1e-7, 0.3))
    term.legend(loc="upper right")


def draw_map(axes: Axes, x: Tensor, q: Tensor, scenario: Scenario, target: Tensor, crest: float | None) -> ContourSet:
    """Panels (c) and (d): `state_cost` over x, and `crest`, where E_O is largest beyond rho_o, m."""
    # The square shows as much of the shallow bowl around the target as of the slope far from it.
    levels = 0.3 * torch.linspace(0.0, 1.0, 46).square()
    filled = axes.contourf(x, x, q.clamp_max(1.0), levels, cmap="cividis", norm=PowerNorm(0.5, 0.0, 0.3), extend="max")
    axes.contour(x, x, q.clamp_max(1.0), levels, colors="white", linewidths=0.4, alpha=0.8)
    angle = torch.linspace(0.0, 2.0 * torch.pi, 181)
    circle = torch.stack([angle.cos(), angle.sin()])
    obstacles = scenario.obstacles
    for k, centre in enumerate(obstacles.centre):
        rho_m, rho_o = float(obstacles.radius[k]), float(obstacles.influence[k])
        axes.fill(*(centre[:, None] + rho_m * circle), color="black", zorder=3)
        rings = [axes.plot(*(centre[:, None] + rho_o * circle), ":", color="white", lw=1.1, label="$l = \\rho_o$")[0]]
        if crest:
            rings += axes.plot(*(centre[:, None] + crest * circle), "--", color=STYLES["printed"][0], lw=1.1)
            rings[1].set_label(f"$l$ = {crest:.1f} m, crest of $E_O$")
    marks = [
        *axes.plot(*minima(x, q).T, "o", mfc="none", mec="white", mew=1.0, ms=8, ls="none", label="minimum"),
        *axes.plot(*target, "*", color="white", mec="black", mew=0.5, ms=7, ls="none", label="target"),
    ]
    axes.set(xlabel="$x$ (m)", ylabel="$y$ (m)", aspect="equal")
    look = {"facecolor": "0.4", "labelcolor": "white", "framealpha": 1.0}
    axes.legend(handles=[*rings, *marks], loc="lower right", **look)
    return filled


@style.paper
def study(settings: DictConfig) -> tuple[dict[str, float | int | None], Figure]:
    """The numbers of metrics.json and the figure."""
    config = compose(list(settings.overrides))
    validate(config)
    assert isinstance(config.cost, PrintedCostConfig), "overrides must hold cost=paper"
    c, nu = remark_2(config.cost.left_m, config.cost.right_m, config.cost.kappa_1, config.cost.kappa_2)
    printed = Printed(settings.c, settings.nu_m)
    forms: dict[str, Avoidance] = {"printed": printed, "remark_2": Printed(c, nu), "default": smooth}
    env = build.make_relay(config)
    scenario, mission = env.scenario, Mission(env, truth_of(env).channel, build.make_cost(config.cost))
    frame = mission.targets.frame
    radii = torch.stack([scenario.obstacles.radius[0], scenario.obstacles.influence[0]])
    x = torch.arange(-4.0, 34.0, settings.spacing_m, dtype=radii.dtype)
    metrics: dict[str, float | int | None] = {"c_remark_2": c, "nu_remark_2_m": nu}

    figure = style.new(style.PAGE, 6.2)
    cut, term, *maps = figure.subplots(2, 2).flatten().tolist()
    draw_curves(cut, term, forms, config.cost, radii)
    for name, form in forms.items():
        height, crest = ring(form, radii[1:])
        given = mission.weights
        weights = CostWeights(given.beta_1, given.beta_2, given.yaw_weight, given.R, form)
        other = replace(mission, weights=weights)
        q = state_cost(other.cost, frame, scenario, x)
        metrics |= {
            f"ring_height_{name}": height,
            f"ring_l_{name}_m": crest,
            f"contact_{name}": float(curve(form, radii[:1], radii[1:])),
            f"minima_{name}": len(minima(x, q)),
        }
        if name != "remark_2":
            filled = draw_map(maps[name == "default"], x, q, scenario, frame.target[0, :2], crest)
    ticks = (0.0, 0.01, 0.03, 0.1, 0.2, 0.3)
    figure.colorbar(filled, ax=maps, ticks=ticks, label="$E_L - E_{L,\\min} + \\beta_2 E_O$")
    for axes, title in zip((cut, term, *maps), TITLES, strict=True):
        axes.set_title(title, pad=4.0 if axes in maps else 13.0)
    return metrics, figure


@hydra.main(version_base="1.3", config_path="conf", config_name="fig3_obstacle_cost")
def main(settings: DictConfig) -> None:
    """Draw the figure and write the numbers to metrics.json."""
    torch.set_num_threads(1)
    metrics, figure = study(settings)
    tell(metrics)
    leave(metrics, figure)


if __name__ == "__main__":
    main()
