"""Fig. 3's numbers against closed forms."""

import json
import runpy
import subprocess
import sys
from pathlib import Path

import pytest
from omegaconf import OmegaConf

EXPERIMENTS = Path(__file__).parents[2] / "experiments"


def study(*overrides: str):
    """Metrics and figure, from maps of 0.5 m."""
    settings = OmegaConf.load(EXPERIMENTS / "conf" / "fig3_obstacle_cost.yaml")
    settings.spacing_m = 0.5
    settings.overrides += overrides
    return runpy.run_path(str(EXPERIMENTS / "fig3_obstacle_cost.py"))["study"](settings)


@pytest.fixture(scope="module")
def result():
    return study()


@pytest.mark.parametrize("form", ["printed", "remark_2", "default"])
def test_contact_is_finite(result, form):
    """(1/rho_m - 1/rho_o)^2 for 2 and 6 m: no barrier."""
    assert result[0][f"contact_{form}"] == pytest.approx((1 / 2 - 1 / 6) ** 2, rel=1e-12)


def test_ring_beyond_the_radius_of_influence(result):
    """At a maximum of f(l) (1/l - 1/rho_o)^2, f' / f = -(c/nu) (l/nu)^(2c - 1) balances 2 / (l^2 (1/rho_o - 1/l))."""
    metrics = result[0]
    l = metrics["ring_l_printed_m"]
    assert (l / 10.0) ** 19 == pytest.approx(2.0 / (l * l * (1 / 6 - 1 / l)), rel=1e-3)
    assert metrics["ring_height_printed"] == pytest.approx(3.152e-3, abs=1e-6)
    assert metrics["ring_height_remark_2"] < 0.01 * metrics["ring_height_printed"]
    assert 6.0 < metrics["ring_l_remark_2_m"] < 6.5
    assert (metrics["ring_height_default"], metrics["ring_l_default_m"]) == (0.0, None)


def test_ring_holds_a_vehicle_if_it_weighs_more(result):
    """With the paper's weights the only minimum is the target; three times beta_2 adds some with the printed form."""
    assert [result[0][f"minima_{form}"] for form in ("printed", "remark_2", "default")] == [1, 1, 1]
    heavy, _ = study("cost.beta_2=3")
    assert heavy["minima_printed"] > 1
    assert [heavy[f"minima_{form}"] for form in ("remark_2", "default")] == [1, 1]


def test_figure_has_four_panels(result):
    titles = [axes.get_title(loc="left")[:3] for axes in result[1].axes[:4]]
    assert titles == ["(a)", "(b)", "(c)", "(d)"]


def test_script_leaves_numbers_and_figure(tmp_path):
    command = [sys.executable, EXPERIMENTS / "fig3_obstacle_cost.py", "spacing_m=0.5", "hydra.run.dir=run"]
    result = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
    metrics = json.loads((tmp_path / "run" / "metrics.json").read_text())
    assert (metrics["status"], metrics["experiment"]) == ("complete", "fig3_obstacle_cost")
    assert f" {metrics['ring_height_printed']}\n" in result.stdout
    assert (tmp_path / "run" / "figures" / "fig3_obstacle_cost.png").stat().st_size > 50_000
