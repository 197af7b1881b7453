"""The app, briefly: what a run leaves behind, and how it fails."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from omegaconf import OmegaConf

from uwirl import algorithm
from uwirl.config.validate import validate
from uwirl.runs import run as runs
from uwirl.snr.estimate import NAMES
from uwirl.study import checkpoint, run_folder

SHORT = ("planner.max_time_s=24", "scenario.duration_s=5")
MISSION = ("capacity_initial_mean_kbps", "capacity_final_mean_kbps", "capacity_optimal_mean_kbps")
SHADOWED = ("capacity_initial_kbps", "capacity_final_kbps", "capacity_optimal_kbps", "snr_map_rmse_dB")
ESTIMATE = [f"estimate_{name}{kind}" for name in NAMES for kind in ("", "_std", "_identifiable")]
# Ten messages after the first, no pictures.
QUIET = ("logging.figures=false", "logging.tensorboard=false", "logging.animation=false", "logging.progress=false")
QUICK = ("experiment=fig5_free", "planner=pd", "scenario.duration_s=5", *QUIET)


@pytest.fixture
def run(make_config, tmp_path):
    def go(*overrides: str):
        config = make_config(*overrides)
        validate(config)
        return config, runs.run(config, "test", tmp_path), tmp_path

    return go


@pytest.fixture(scope="module")
def complete(tmp_path_factory):
    """One short run with everything on."""
    from uwirl.config.compose import compose

    folder = tmp_path_factory.mktemp("run")
    config = compose(SHORT)
    return config, runs.run(config, "test", folder), folder


def test_metrics_file_is_flat_json(complete):
    _, metrics, folder = complete
    written = json.loads((folder / "metrics.json").read_text())
    assert written["status"] == "complete"
    assert written["error"] is None
    assert {
        "experiment",
        "config_hash",
        "seed",
        "uwirl_version",
        "wall_time_s",
        *MISSION,
        *SHADOWED,
        *ESTIMATE,
    } < written.keys()
    assert not any(isinstance(value, dict) for value in written.values())
    assert len(written["cost_per_iteration"]) == written["policy_iterations"] == 8
    assert written["learning_vehicle_seconds"] == 24.0
    assert written["learning_env_steps"] == 480
    assert written["capacity_initial_mean_kbps"] == pytest.approx(17.302, abs=1e-3)
    assert written["cost_total"] == metrics["cost_total"]


def test_config_file_composes_the_same_run(complete):
    config, _, folder = complete
    written = OmegaConf.to_container(OmegaConf.load(folder / "config.yaml"))
    assert written["planner"]["max_time_s"] == 24.0
    assert written["scenario"]["start"] == config.scenario.start


def test_trajectory_file(complete):
    _, metrics, folder = complete
    data = np.load(folder / "trajectory.npz")
    shapes = {name: data[name].shape for name in data.files}
    assert shapes == {
        "time_s": (101,),
        "eta": (101, 1, 4),
        "nu": (101, 1, 4),
        "tau": (100, 1, 4),
        "link_capacity_kbps": (101, 2),
        "message_time_s": (11,),
        "link_capacity_shadowed_kbps": (11, 2),
    }
    assert data["link_capacity_kbps"][-1].tolist() == metrics["link_capacity_final_kbps"]
    assert data["message_time_s"].tolist() == pytest.approx([0.5 * k for k in range(11)])
    first, last = data["link_capacity_shadowed_kbps"][[0, -1]].min(-1).tolist()
    assert first == pytest.approx(metrics["capacity_initial_kbps"], rel=1e-12)
    assert last == pytest.approx(metrics["capacity_final_kbps"], rel=1e-12)


def test_checkpoint_holds_the_learned_weights(complete):
    content = checkpoint.load(complete[2] / "checkpoints" / "last.pt")
    assert content["actor"].shape == (1, 17)
    assert content["iteration"] == 8
    assert content["metrics"]["cost_total_start_policy"] == complete[1]["cost_total_start_policy"]


def test_figure_and_tensorboard_are_there(complete):
    folder = complete[2]
    assert (folder / "figures" / "mission.png").stat().st_size > 50_000
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    events = EventAccumulator(str(folder / "tb")).Reload()
    tags = set(events.Tags()["scalars"])
    assert {"snr/K_dB", "critic/W_link_cost", "actor_yaw/W_uv", "capacity/min_kbps", "cost/total", "cost/link"} < tags
    costs = [event.value for event in events.Scalars("cost/total")]
    assert costs == pytest.approx(complete[1]["cost_per_iteration"], rel=1e-6)


def test_planner_that_does_not_learn(run):
    _, metrics, folder = run("planner=pd", "scenario.duration_s=5", "logging.tensorboard=false")
    assert metrics["status"] == "complete"
    assert "policy_iterations" not in metrics
    assert not (folder / "checkpoints").exists()
    assert not (folder / "tb").exists()


def test_two_vehicles_estimate_one_channel_each(run):
    _, metrics, folder = run(*QUICK, "scenario.start=[[5,5,-6,0],[29.5,29.5,0,1]]")
    written = json.loads((folder / "metrics.json").read_text())
    assert written["status"] == "complete"
    assert all(len(written[key]) == 2 for key in (*ESTIMATE, "snr_map_rmse_dB"))
    assert written["estimate_K_dB"] == metrics["estimate_K_dB"]
    assert written["estimate_K_dB"][0] != written["estimate_K_dB"][1]
    # The paper's shadowing is too weak to be told.
    assert written["estimate_zeta2"] == written["estimate_zeta2_std"] == [None, None]
    assert np.load(folder / "trajectory.npz")["link_capacity_shadowed_kbps"].shape == (11, 3)


def test_without_fading_nothing_is_left_to_estimate(run):
    """The oracle and a channel of path loss alone: both kinds of capacity are the same."""
    _, metrics, _ = run(*QUICK, "channel.zeta_dB=0", "channel.rho_dB=0", "estimator=oracle")
    assert (metrics["status"], metrics["error"]) == ("complete", None)
    assert (metrics["estimate_K_dB"], metrics["estimate_n"]) == (-60.0, 5.0)
    assert [metrics[key] for key in SHADOWED[:3]] == pytest.approx([metrics[key] for key in MISSION], rel=1e-9)
    assert metrics["snr_map_rmse_dB"] < 1e-10


@pytest.mark.parametrize(
    ("override", "error"),
    [
        ("estimator=disk", "NoTargetError: estimator: the estimated SNR does not fall with distance (n = 0)"),
        ("scenario.hearing_range_m=1", "UnidentifiableError: nothing was heard: no sensor is within scenario.hearing"),
        # Only the first hears the vehicle, and neither source nor destination.
        (
            "scenario.sensors=[[29.5,29.5,-1],[0,0,-8],[-9,-9,-8]] scenario.hearing_range_m=5",
            "UnidentifiableError: 1 readings cannot determine K, n and the fading: at least 3 are needed",
        ),
    ],
)
def test_readings_that_allow_no_plan_fail_and_say_so(run, override: str, error: str):
    _, _, folder = run(*QUICK, *override.split())
    written = json.loads((folder / "metrics.json").read_text())
    assert written["status"] == "failed"
    assert written["error"].startswith(error)
    assert not (folder / "trajectory.npz").exists()


def test_inadmissible_start_fails_and_says_so(run):
    _, metrics, folder = run(*SHORT, "planner.start_gain=-1", "logging.figures=false")
    written = json.loads((folder / "metrics.json").read_text())
    assert written["status"] == "failed"
    assert written["error"].startswith("InadmissiblePolicyError: planner: the start policy is not admissible")
    assert "running cost grew from" in metrics["error"]


def test_not_a_number_fails_with_step_and_quantity(run, monkeypatch):
    from uwirl.world.vehicle import Vehicle

    rk4 = Vehicle.rk4
    # The first call checks the vehicle when it is made.
    calls = iter(range(-1, 10_000))

    def poisoned(self, x, tau, dt, out):
        return rk4(self, x, tau, dt, out).mul_(torch.nan if next(calls) == 7 else 1.0)

    monkeypatch.setattr(Vehicle, "rk4", poisoned)
    _, metrics, _ = run(*SHORT)
    assert metrics["status"] == "failed"
    assert metrics["error"] == "DivergedError: tau is not finite at step 8 (t = 0.4 s of the flight)"


def test_hash_changes_with_what_changes_the_result(make_config):
    base = run_folder.config_hash(make_config())
    assert run_folder.config_hash(make_config("logging.figures=false")) == base
    assert run_folder.config_hash(make_config("seed=1")) != base
    assert run_folder.config_hash(make_config("cost.yaw_weight=0.02")) != base


def test_numbers_that_json_lacks_become_null(tmp_path):
    run_folder.write_metrics(tmp_path, {"a": float("nan"), "b": [1.0, float("inf")]})
    assert json.loads((tmp_path / "metrics.json").read_text()) == {"a": None, "b": [1.0, None]}


def test_multirun_goes_on_after_a_bad_job(tmp_path):
    """One job of three cannot run: the others do, and the exit code is 1."""
    command = [sys.executable, "-m", "uwirl.apps.run", "-m", "planner=pd", "planner.saturation_m=4,-4,5", *SHORT[1:]]
    quiet = ["logging.figures=false", "logging.tensorboard=false"]
    result = subprocess.run([*command, *quiet], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert result.returncode == 1
    assert "planner.saturation_m: must be greater than 0, got -4" in result.stderr
    written = {path.parent.name: json.loads(path.read_text()) for path in tmp_path.rglob("metrics.json")}
    status = {name.split("planner.saturation_m=")[1].split(",")[0]: job["status"] for name, job in written.items()}
    assert status == {"4": "complete", "-4": "failed", "5": "complete"}
    (failed,) = (job for job in written.values() if job["status"] == "failed")
    assert failed["error"] == "ConfigError: planner.saturation_m: must be greater than 0, got -4"
    assert failed["experiment"] == "fig5_single"
    assert (failed["seed"], len(failed["config_hash"])) == (0, 16)


def test_multirun_refuses_ablations_that_are_undone_one_by_one(tmp_path):
    words = ["-m", "planner=pd", "ablation=none,no_shadowing", "channel.zeta_dB=0.1", *QUICK[2:]]
    command = [sys.executable, "-m", "uwirl.apps.run", *words]
    result = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert result.returncode == 1
    errors = [json.loads(path.read_text())["error"] for path in sorted(tmp_path.rglob("metrics.json"))]
    undone = "ConfigError: channel.zeta_dB: 0.1 undoes ablation=no_shadowing, which sets 0.0; drop one of the two"
    assert sorted(errors, key=str) == [undone, None]


def test_installed_wheel_runs_from_another_folder(tmp_path):
    """Built, unpacked and run where no checkout is: it must find the configuration inside the package."""
    root = Path(__file__).parents[2]
    build = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(tmp_path), str(root)]
    subprocess.run(build, check=True, capture_output=True)
    (wheel,) = tmp_path.glob("*.whl")
    site, cwd = tmp_path / "site", tmp_path / "elsewhere"
    cwd.mkdir()
    install = [sys.executable, "-m", "pip", "install", "--no-deps", "--no-index", "--target", str(site), str(wheel)]
    subprocess.run(install, check=True, capture_output=True)
    program = "from uwirl.apps.run import main; from uwirl.config import compose; print(compose.folder()); main()"
    result = subprocess.run(
        [sys.executable, "-c", program, "planner=pd"],
        cwd=cwd,
        env={"PYTHONPATH": str(site), "PATH": "/usr/bin:/bin"},
        capture_output=True,
        text=True,
        check=True,
    )
    assert result.stdout.splitlines()[0] == str(site / "uwirl" / "conf")
    assert len(list(cwd.rglob("metrics.json"))) == 1


def test_a_bug_is_written_down_and_raised(run, monkeypatch, tmp_path):
    def broken(*arguments):
        raise KeyError("not foreseen")

    monkeypatch.setattr(algorithm, "estimate_each_vehicle", broken)
    with pytest.raises(KeyError):
        run(*SHORT)
    written = json.loads((tmp_path / "metrics.json").read_text())
    assert (written["status"], written["error"]) == ("failed", "KeyError: 'not foreseen'")
