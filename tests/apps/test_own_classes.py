"""The classes of examples/own.py, through the commands that docs/extending.md gives."""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path

import pytest
import torch

from uwirl import build
from uwirl.apps import evaluate, run
from uwirl.config.validate import ConfigError, validate
from uwirl.study import run_folder

EXAMPLES = Path(__file__).parents[2] / "examples"
QUIET = ("logging.figures=false", "logging.tensorboard=false", "logging.progress=false")
FREE = ("experiment=fig5_free", "scenario.duration_s=20", *QUIET)


@pytest.fixture(autouse=True)
def examples(monkeypatch):
    monkeypatch.setattr(sys, "path", sys.path.copy())
    monkeypatch.chdir(EXAMPLES)


@pytest.fixture
def fly(call, tmp_path):
    """fly("key=value", ...): what a run leaves in metrics.json."""

    def flown(*overrides: str):
        flags, words = overrides[:2] if overrides[0].startswith("--") else (), overrides
        words = [word for word in words if word not in flags]
        call(run.main, *flags, *FREE, *words, f"hydra.run.dir={tmp_path}/run")
        return run_folder.read_metrics(tmp_path / "run")

    return flown


def test_planner(fly):
    metrics = fly("planner=custom", "planner.target=own.Pursuit", "+planner.settings.speed_mps=0.5")
    assert metrics["status"] == "complete"
    # From 15 m away straight at the target, at no more than the speed.
    assert 0.8 * 0.5 * 20.0 < metrics["path_length_m"] <= 0.5 * 20.0


def test_a_new_planner_is_a_module_and_a_file(fly, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.py").write_text(
        "from uwirl import Feedback\n"
        "class Hover:\n"
        "    def __init__(self, share):\n"
        "        self.share = share\n"
        "    def fit(self, env, estimate):\n"
        "        return Feedback(lambda seen: self.share * env.vehicle.trim.expand(*seen.eta.shape))\n"
    )
    (tmp_path / "conf" / "planner").mkdir(parents=True)
    option = "name: mine\ntarget: mine.Hover\nsettings: {share: 1.0}\n"
    (tmp_path / "conf" / "planner" / "mine.yaml").write_text(option)
    metrics = fly("--config-dir", "conf", "planner=mine")
    assert metrics["status"] == "complete"
    assert metrics["path_length_m"] < 0.1
    sys.modules.pop("mine")


def test_estimator(fly):
    metrics = fly("planner=pd", "estimator=own", "estimator.target=own.known_exponent", "+estimator.settings.n=5")
    assert metrics["status"] == "complete"
    assert metrics["estimate_n"] == 5.0
    assert metrics["estimate_K_dB"] == pytest.approx(-60.0, abs=4.0 * metrics["estimate_K_dB_std"])
    assert not metrics["estimate_varphi_m_identifiable"]


def test_vehicle(fly):
    free = ("planner=own", "planner.target=own.Pursuit", "+planner.settings={speed_mps: 0.5, gain: 5}")
    worn = ("vehicle.target=own.WornThrusters", "+vehicle.settings.dead_zone=[200,200,0,200]")
    # No thrust of this vehicle's reaches beyond the dead zone.
    assert fly(*free, *worn)["path_length_m"] < 1.0


def test_channel(fly):
    short = ("planner=pd", "estimator=oracle", "scenario.duration_s=5")
    coded = fly(*short, "channel.target=own.CodedModem", "+channel.settings.gap_dB=3")
    # Midway, 42.4 m from either node, the paper's channel has 18.6 dB.
    snr = 10.0 ** ((100.0 - 50.0 * math.log10(math.sqrt(1800.0)) - 3.0) / 10.0)
    assert coded["capacity_optimal_mean_kbps"] == pytest.approx(10.0 * math.log2(1.0 + snr), rel=1e-4)


def test_a_gap_shifts_the_snr(make_config):
    config = make_config("channel.target=own.CodedModem", "+channel.settings.gap_dB=3")
    validate(config)
    channel = build.make_channel(config.channel)
    plain = build.make_channel(make_config().channel)
    snr = torch.linspace(-10.0, 30.0, 5, dtype=torch.float64)
    torch.testing.assert_close(channel.capacity_kbps(snr + 3.0), plain.capacity_kbps(snr))
    assert channel.budget.snr_for_dB(20.0) == pytest.approx(plain.budget.snr_for_dB(20.0) + 3.0)


def test_basis_learns_and_is_evaluated(fly, call, tmp_path):
    basis = ("basis=own", "basis.target=own.HyperbolicBasis", "+basis.settings.length_scales_m=[2,20]")
    metrics = fly(*basis, "planner.max_time_s=60")
    assert metrics["cost_total"] < metrics["cost_total_start_policy"]
    call(evaluate.main, f"checkpoint={tmp_path}/run", f"hydra.run.dir={tmp_path}/again")
    assert json.loads((tmp_path / "again" / "metrics.json").read_text())["cost_total"] == metrics["cost_total"]


def test_what_only_objects_show_is_checked_when_they_are_made(make_config, tmp_path, monkeypatch):
    (tmp_path / "bare.py").write_text(
        "class Bare:\n"
        "    def __init__(self, **parameters): ...\n"
        "    def saturate(self, tau): ...\n"
        "    def step(self, state, tau, dt, current=None, out=None): ...\n"
    )
    monkeypatch.chdir(tmp_path)
    config = make_config("vehicle.target=bare.Bare")
    validate(config)
    with pytest.raises(ConfigError, match=r"vehicle.target: bare.Bare is no uwirl.*Dynamics: it has no tau_max, trim"):
        build.make_relay(config)


OWN = """
import torch
from uwirl import Feedback
from uwirl.world.acoustics import LinkBudget
from uwirl.world.vehicle import Vehicle

class Nothing:
    def fit(self, env, estimate): pass
class Matrix(Nothing):
    def fit(self, env, estimate): return torch.eye(4)
class Flat(Nothing):
    def fit(self, env, estimate): return Feedback(lambda seen: seen.eta[..., :3])
class List(Nothing):
    def fit(self, env, estimate): return Feedback(lambda seen: [0.0] * 4)
def pair(readings, budget): return -60.0, 5.0
class Mean(LinkBudget):
    def capacity_kbps(self, snr_dB): return super().capacity_kbps(snr_dB).mean()
class Half(Vehicle):
    def step(self, state, tau, dt, current=None, out=None): return state.components[:4]
"""


@pytest.mark.parametrize(
    ("option", "told"),
    [
        ("planner.target=wrong.Nothing", "Nothing.fit must return an agent, with init and act, got None"),
        ("planner.target=wrong.Matrix", "Matrix.fit must return an agent, with init and act, got a Tensor"),
        (
            "planner.target=wrong.Flat",
            "must be floating-point [1, 1, 4] (world, vehicle, axis), got torch",
        ),
        ("planner.target=wrong.List", "must be floating-point [1, 1, 4] (world, vehicle, axis), got list"),
        ("estimator.target=wrong.pair", "estimator must return a ChannelEstimate, got a tuple"),
        (
            "channel.target=wrong.Mean",
            "capacity_kbps of Mean must be floating-point [2, 3] (as its argument), got",
        ),
        (
            "vehicle.target=wrong.Half",
            "Half.step must be floating-point [8, 2, 3] (component, world, vehicle), got",
        ),
    ],
)
def test_wrong_results_are_one_message(call, tmp_path, monkeypatch, capsys, option: str, told: str):
    (tmp_path / "wrong.py").write_text(OWN)
    monkeypatch.chdir(tmp_path)
    family = option.partition(".")[0]
    others = {"planner": ("planner=custom",), "estimator": ("estimator=custom", "planner=pd")}
    with pytest.raises(SystemExit, match="1"):
        call(run.main, *FREE, *others.get(family, ("planner=pd",)), option, f"hydra.run.dir={tmp_path}/run")
    metrics = run_folder.read_metrics(tmp_path / "run")
    assert metrics["status"] == "failed"
    assert told in metrics["error"]
    assert "Traceback" not in capsys.readouterr().err
    sys.modules.pop("wrong")
