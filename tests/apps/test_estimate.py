"""`uwirl-estimate`: the sample log gives the channel it was made with; bad input is one line and leaves nothing."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from omegaconf import OmegaConf

from uwirl.config.compose import compose, composed, to_object
from uwirl.config.estimate_schema import register
from uwirl.config.validate import validate_estimate
from uwirl.runs import survey
from uwirl.runs.run import run as fly
from uwirl.runs.saving import Origin
from uwirl.runs.survey import Prepared, run
from uwirl.snr.estimate import NAMES
from uwirl.study.checkpoint import CheckpointError

SAMPLE = Path(__file__).parents[2] / "examples" / "readings.csv"
TRUTH = {"K_dB": -60.0, "n": 2.0, "zeta2": 9.0, "varphi_m": 15.0, "rho2": 1.0}
HEADER = "vehicle_x_m,vehicle_y_m,vehicle_z_m,sensor_x_m,sensor_y_m,sensor_z_m,snr_dB"


def prepare(*overrides: str) -> Prepared:
    register()
    config = to_object(composed("estimate", overrides))
    validate_estimate(config)
    return survey.prepare(config)


@pytest.fixture
def write(tmp_path):
    def go(*rows: str) -> str:
        path = tmp_path / "log.csv"
        path.write_text("\n".join([HEADER, *rows]) + "\n")
        return f"data={path}"

    return go


@pytest.fixture
def estimate(tmp_path):
    """Metrics of a run without a figure."""
    return lambda *overrides: run(prepare("logging.figures=false", *overrides), tmp_path)


@pytest.fixture(scope="module")
def sample(tmp_path_factory):
    """Metrics, written and returned, and folder of a run on the sample log."""
    folder = tmp_path_factory.mktemp("sample")
    metrics = run(prepare(f"data={SAMPLE}"), folder)
    return metrics, json.loads((folder / "metrics.json").read_text()), folder


def test_sample_log_gives_the_channel_it_was_made_with(sample):
    metrics = sample[1]
    assert metrics["status"] == "complete"
    for name in NAMES:
        assert metrics[f"estimate_{name}_identifiable"]
        assert abs(metrics[f"estimate_{name}"] - TRUTH[name]) < 3.0 * metrics[f"estimate_{name}_std"]
    assert (metrics["messages"], metrics["sensors"]) == (20, 16)
    assert metrics["readings"] + metrics["dropouts"] == 320
    assert metrics["readings_used"] == metrics["readings"]
    assert metrics["residual_rms"] == pytest.approx(1.0, abs=0.1)
    # The ten places have about 16 links each, read twice.
    assert metrics["links"] == 160
    assert metrics["leave_one_out_rmse_dB"] < 0.8 * metrics["leave_one_out_rmse_path_loss_dB"]
    assert metrics["accused_sensors"] == metrics["accused_sensors_dB"] == metrics["warnings"] == []
    low, high = metrics["estimate_zeta2_possible"]
    assert low < metrics["estimate_zeta2"] < high < 3.0 * low
    assert not any(isinstance(value, dict) for value in metrics.values())


def test_arrays(sample):
    metrics, _, folder = sample
    data = np.load(folder / "estimate.npz")
    shape = len(data["y_m"]), len(data["x_m"])
    assert 3000 < shape[0] * shape[1] < 4000
    for name in ("snr_mean_dB", "snr_std_dB", "capacity_kbps", "outage"):
        assert data[name].shape == shape
    assert len(data["residual_dB"]) == len(data["standardized"]) == len(data["line"]) == metrics["readings"]
    assert np.sqrt(np.mean(data["standardized"] ** 2)) == pytest.approx(metrics["residual_rms"])
    # Half the median capacity is the default threshold; the expected SNR carries it where outage is below one half.
    assert metrics["map_capacity_kbps"] == pytest.approx(0.5 * np.nanmedian(data["capacity_kbps"]), rel=1e-3)
    told = ~np.isnan(data["outage"])
    assert ((data["outage"] < 0.5) == (data["capacity_kbps"] > metrics["map_capacity_kbps"]))[told].all()


def test_figure_config_and_log(sample):
    folder = sample[2]
    assert (folder / "figures" / "estimate.png").stat().st_size > 50_000
    written = OmegaConf.load(folder / "config.yaml")
    assert (written.data, written.map.from_m) == (str(SAMPLE), None)


def test_map_settings(estimate, tmp_path):
    place = ["map.from_m=[0,0,-5]", "map.z_m=-3", "map.spacing_m=5", "map.capacity_kbps=12"]
    metrics = estimate(f"data={SAMPLE}", *place)
    data = np.load(tmp_path / "estimate.npz")
    assert np.diff(data["x_m"]) == pytest.approx(5.0)
    assert (float(data["z_m"]), data["from_m"].tolist()) == (-3.0, [0.0, 0.0, -5.0])
    assert (metrics["map_from_m"], metrics["map_capacity_kbps"]) == ([0.0, 0.0, -5.0], 12.0)


def test_thinned_log_says_so(estimate, caplog):
    with caplog.at_level("INFO", "uwirl"):
        metrics = estimate(f"data={SAMPLE}", "max_readings=60")
    assert (metrics["readings"], metrics["readings_used"]) == (307, 60)
    assert "60 readings are used, evenly over messages and sensors (max_readings=60)" in caplog.text


def test_what_looks_wrong_is_told(estimate, tmp_path, caplog):
    lines = SAMPLE.read_text().splitlines()
    cells = lines[99].split(",")
    lines[99] = ",".join([*cells[:-1], str(float(cells[-1]) + 25.0)])
    # One sensor reads 15 dB too little.
    lines = [
        line.rsplit(",", 1)[0] + f",{float(line.rsplit(',', 1)[1] or 0) - 15}" if "-05" in line else line
        for line in lines
    ]
    path = tmp_path / "wrong.csv"
    path.write_text("\n".join(lines) + "\n")
    with caplog.at_level("INFO", "uwirl"):
        metrics = estimate(f"data={path}")
    assert metrics["residual_worst_line"] == 100
    assert "line 100 does not belong: +" in caplog.text
    assert metrics["accused_sensors"] == ["buoy-05"]
    assert metrics["accused_sensors_dB"] == pytest.approx([-15.0], abs=5.0)
    assert "sensor buoy-05 does not agree with the others: -" in caplog.text
    assert "residuals are not normal" in caplog.text
    assert metrics["warnings"]
    assert all(f"warning: {sentence}" in caplog.text for sentence in metrics["warnings"])
    caplog.clear()
    with caplog.at_level("INFO", "uwirl"):
        metrics = estimate(f"data={path}", "estimator.robust=true")
    assert metrics["readings_refused"] >= 1
    assert "do not belong and are left out (estimator.robust)" in caplog.text


def test_doubts_come_before_the_map(estimate, write, caplog):
    """Received power, with a depth that changes its sign between columns, after a loss of power."""
    rows = [f"{x},0,-18,0,{x % 7},18,{-40 - x / 3 + x % 3}" for x in range(10, 80, 5)]
    with caplog.at_level("INFO", "uwirl"):
        metrics = estimate(write("\0" + rows[0], *rows[1:]))
    starts = ["NUL bytes were skipped on line 2", "sensors lie up to 18 m above the surface", "snr_dB is -5"]
    assert [any(text.startswith(start) for text in metrics["warnings"]) for start in starts] == [True] * 3
    assert "nothing looks wrong" not in caplog.text


@pytest.mark.parametrize("estimator", ["least_squares", "generalized_least_squares", "separate"])
def test_other_estimators(estimate, estimator: str):
    assert estimate(f"data={SAMPLE}", f"estimator={estimator}")["status"] == "complete"


def test_standing_stations(estimate, write, caplog, tmp_path):
    """Of a vehicle that does not move: 3 dB of shadowing widen the map between stations, and nobody is accused."""
    offsets = (2.5, -3.1, 1.2, 3.9, -2.6, -1.8, 3.3, -3.4)
    rows = [
        f"0,0,-5,{40 * k + 20},0,-5,{44 - 20 * math.log10(40 * k + 20) + offset + 0.7 * math.sin(12.9 * ping + k)}"
        for k, offset in enumerate(offsets)
        for ping in range(20)
    ]
    with caplog.at_level("INFO", "uwirl"):
        metrics = estimate(write(*rows), "channel.absorption=none", "channel.frequency_khz=null", "map.from_m=[0,0,-5]")
    assert metrics["estimate_zeta2"] is metrics["estimate_varphi_m"] is None
    assert metrics["accused_sensors"] == []
    assert "nothing looks wrong" in caplog.text
    low, high = metrics["estimate_zeta2_possible"]
    assert low < np.var(offsets, ddof=2) < high
    std = np.load(tmp_path / "estimate.npz")["snr_std_dB"]
    assert 2.5 < np.nanmedian(std) < 8.0


def test_few_readings_tell_no_fading(estimate, write, caplog):
    rows = [f"0,0,0,{x},{x * x % 7},-5,{30 - x / 3 + x % 3}" for x in range(10, 80, 10)]
    with caplog.at_level("INFO", "uwirl"):
        metrics = estimate(write(*rows))
    assert metrics["status"] == "complete"
    assert metrics["estimate_varphi_m"] is None
    assert "unidentifiable" in caplog.text
    assert "nan" not in caplog.text


@pytest.mark.parametrize(
    "rows",
    [
        # The only reading at its distance: nothing predicts it.
        ["0,0,0,10,0,0,20", "0,0,0,0,10,0,21", "0,0,0,20,0,0,12"],
        # On the path loss exactly.
        [f"0,0,0,{10 ** (k / 4)},0,0,{30 - 5 * k}" for k in range(1, 9)],
        # Every reading twice.
        2 * [f"0,0,0,{x},0,-5,{30 - x / 3}" for x in range(10, 80, 10)],
    ],
    ids=["alone", "noiseless", "repeated"],
)
def test_strange_logs_are_no_bugs(estimate, write, rows: list[str]):
    metrics = estimate(write(*rows), "channel.absorption=none", "channel.frequency_khz=null")
    assert metrics["status"] == "complete"


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        ([], "data: names no log"),
        (["data=nowhere.csv"], "data: nowhere.csv does not exist"),
        (["data=/"], "data: / is a folder"),
        ([f"data={SAMPLE}", "estimator=oracle"], "estimator.name: 'oracle' is the truth of a simulation"),
        ([f"data={SAMPLE}", "estimator=disk"], "estimator.name: 'disk' knows no distance"),
        ([f"data={SAMPLE}", "estimator.name=irk"], "estimator.name: 'irk' is none of"),
        ([f"data={SAMPLE}", "max_readings=2"], r"max_readings: must lie in \[3, 5,000\], got 2"),
        ([f"data={SAMPLE}", "map.from_m=[1,2]"], "map.from_m: needs 3 finite numbers"),
        ([f"data={SAMPLE}", "map.z_m=inf"], "map.z_m: must lie within 100,000,000 m"),
        ([f"data={SAMPLE}", "map.spacing_m=0"], "map.spacing_m: must be greater than 0"),
        ([f"data={SAMPLE}", "map.spacing_m=0.01"], "map.spacing_m: 0.01 m makes a map of .* nodes, too many"),
        ([f"data={SAMPLE}", "map.spacing_m=500"], "map.spacing_m: 500 m leaves fewer than 3 nodes"),
        ([f"data={SAMPLE}", "map.capacity_kbps=1e4"], "map.capacity_kbps: 10000 kbit/s is beyond any link"),
        ([f"data={SAMPLE}", "channel.bandwidth_khz=0"], "channel.bandwidth_khz: must be greater than 0"),
        ([f"data={SAMPLE}", "threads=0"], "threads: must be at least 1"),
    ],
)
def test_bad_setting(overrides: list[str], message: str):
    with pytest.raises(ValueError, match=f"^{message}"):
        prepare(*overrides)


def test_too_few_readings(write):
    with pytest.raises(ValueError, match=r"log.csv: 2 readings cannot determine K, n and the fading"):
        prepare(write("0,0,0,10,0,0,20", "0,0,0,20,0,0,12", "0,0,0,30,0,0,"))


def test_one_distance(write):
    with pytest.raises(ValueError, match=r"log.csv: all 3 readings are over 10 m"):
        prepare(write("0,0,0,10,0,0,20", "0,0,0,0,10,0,21", "0,0,0,0,0,-10,19"))


def test_degrees(write):
    with pytest.raises(ValueError, match=r"log.csv: x \(10 to 10.003\) and y \(54 to 54.002\) look like degrees"):
        prepare(write("10,54,0,10.001,54,0,20", "10,54,0,10.003,54,0,12", "10,54,0,10,54.002,0,14"))


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (["data=log.csv"], "log.csv, line 2, column snr_dB: 'x' is no number; write one such as -12.5\n"),
        (["data=log.csv", "map.spacing=1"], "map.spacing"),
        ([], "data: names no log; give a CSV file, as in `uwirl-estimate data=readings.csv`\n"),
    ],
)
def test_command_answers_bad_input_in_one_line(tmp_path, overrides: list[str], message: str):
    (tmp_path / "log.csv").write_text(f"{HEADER}\n0,0,0,10,0,0,x\n")
    command = [sys.executable, "-m", "uwirl.apps.estimate", *overrides]
    result = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert result.returncode == 2
    assert result.stderr.startswith("uwirl-estimate: ")
    assert message in result.stderr
    assert "Traceback" not in result.stderr
    assert result.stdout == ""
    assert [path.name for path in tmp_path.iterdir()] == ["log.csv"]


def test_command_leaves_a_run_folder(tmp_path):
    command = [sys.executable, "-m", "uwirl.apps.estimate", f"data={SAMPLE}", "logging.figures=false"]
    result = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
    assert "varphi (m)" in result.stdout
    (folder,) = (tmp_path / "outputs" / "estimate").iterdir()
    written = {"config.yaml", "estimate.npz", "metrics.json", "run.log", "checkpoints"}
    assert {path.name for path in folder.iterdir()} == written


def test_sigterm_ends_it_and_says_so(tmp_path):
    """Sent by the run to itself while it draws the map, so that the moment is always the same."""
    program = (
        "import os, signal; from uwirl.study import survey; from uwirl.apps.estimate import main\n"
        "survey.make_map = lambda *_: os.kill(os.getpid(), signal.SIGTERM); main()"
    )
    command = [sys.executable, "-c", program, f"data={SAMPLE}", "hydra.run.dir=run"]
    result = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert result.returncode == 143
    assert "Traceback" not in result.stderr
    written = json.loads((tmp_path / "run" / "metrics.json").read_text())
    assert written["status"] == "interrupted"
    assert written["error"].startswith("interrupted by SIGTERM with nothing saved to continue from")
    assert not (tmp_path / "run" / "estimate.npz").exists()


QUIET = ("logging.figures=false", "logging.tensorboard=false")
FLOWN = ("channel=acoustic_24khz", "planner=pd", "experiment=fig5_free", "scenario.duration_s=1", *QUIET)


@pytest.mark.parametrize("vehicles", [1, 2])
def test_missions_fly_on_an_estimate(sample, tmp_path, vehicles):
    metrics, _, folder = sample
    words = (*FLOWN, f"init_from={folder}", "init_from_parts=[estimate]", f"scenario.vehicles={vehicles}")
    flown = fly(compose(words), "fig5_free", tmp_path, words)
    assert flown["status"] == "complete"
    for name in NAMES:
        values = flown[f"estimate_{name}"]
        assert values == (metrics[f"estimate_{name}"] if vehicles == 1 else [metrics[f"estimate_{name}"]] * 2)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("init_from={}", "channel=paper"), "other noise and absorption .*here -160.00 dB.*N0_dB"),
        (("init_from={}", "channel.frequency_khz=12"), "other noise and absorption"),
        (("init_from={}", "init_from_parts=[weights]"), "holds a channel estimate and no weights"),
        (("resume={}",), "holds a channel estimate and no policy"),
    ],
)
def test_what_an_estimate_does_not_serve_for_is_refused(sample, words, message):
    *_, folder = sample
    config = compose(["channel=acoustic_24khz", *(word.format(folder) for word in words)])
    with pytest.raises(CheckpointError, match=message):
        Origin.of(config)
