"""Fig. 2's numbers against the channel's own statistics."""

import runpy
from pathlib import Path

import pytest
import torch
from omegaconf import OmegaConf

EXPERIMENTS = Path(__file__).parents[2] / "experiments"
CHANNELS = ["acoustic_24khz", "paper"]


@pytest.fixture(scope="module")
def script():
    return runpy.run_path(str(EXPERIMENTS / "fig2_channel.py"))


@pytest.fixture(scope="module", params=CHANNELS)
def result(script, request):
    """Metrics and figure, from maps of 2 m."""
    settings = OmegaConf.load(EXPERIMENTS / "conf" / "fig2_channel.yaml")
    settings.spacing_m = 2.0
    settings.overrides = [f"channel={request.param}"]
    return script["study"](settings)


def test_shadowing_has_the_channel_s_statistics(result):
    """Over 64 worlds; in a single one the map holds too few independent places for the second."""
    metrics = result[0]
    assert metrics["shadowing_std_worlds_dB"] == pytest.approx(metrics["zeta_dB"], rel=0.05)
    assert metrics["correlation_at_varphi_worlds"] == pytest.approx(0.3679, abs=0.04)
    assert metrics["shadowing_std_map_dB"] == pytest.approx(metrics["zeta_dB"], rel=0.35)


def test_multipath_has_power_rho(result):
    """2,500 independent draws: their standard deviation is known to 1.4 %."""
    assert result[0]["multipath_std_map_dB"] == pytest.approx(result[0]["rho_dB"], rel=0.06)


def test_panels_add_up(script, make_relay):
    env = make_relay("channel=acoustic_24khz")
    places = torch.tensor([[0.0, 0.0, -8.0], [30.0, 30.0, -8.0]], dtype=torch.float64)
    drawn = script["fields"](env, places, 0)
    mean, shadowed, faded, everything = drawn.panels
    # K - 10 n log10(l) - a l / 1000 - N0 at 42.43 and 84.85 m.
    assert mean.tolist() == pytest.approx([11.207, 4.945], abs=2e-3)
    assert torch.allclose(everything - mean, (shadowed - mean) + (faded - mean), rtol=0.0, atol=1e-12)
    again = script["fields"](env, places, 1)
    assert torch.equal(again.shadowing, drawn.shadowing)
    assert not bool((again.multipath == drawn.multipath).any())


def test_figure_has_six_panels(result):
    assert [axes.get_title(loc="left")[:3] for axes in result[1].axes[:6]] == [f"({k})" for k in "abcdef"]


def test_colour_bar_names_round_numbers(result):
    axes = result[1].axes[6]
    shown = [tick for tick in axes.get_yticks() if axes.get_ylim()[0] <= tick <= axes.get_ylim()[1]]
    assert len(shown) >= 5
    assert not any(tick % 5 for tick in shown)
