"""What was learned, used elsewhere: `uwirl-evaluate` and `init_from`."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pytest
import torch

from uwirl.apps import evaluate
from uwirl.config.compose import compose
from uwirl.config.schema import register
from uwirl.config.validate import ConfigError, validate
from uwirl.runs.run import evaluate as fly_checkpoint
from uwirl.runs.run import run
from uwirl.study import checkpoint, learning_file, shadowing
from uwirl.study.checkpoint import CheckpointError

QUIET = ("logging.figures=false", "logging.tensorboard=false", "logging.animation=false", "logging.progress=false")
SHORT = ("experiment=fig5_free", "planner.max_time_s=34", "scenario.duration_s=2", *QUIET)
PAIR = "scenario.start=[[29.5,29.5,0,1],[25,24,-5,0]]"
OBSTACLE = "scenario.obstacles=[{center_m:[21,18],radius_m:2,influence_m:6}]"
TRIO = "scenario.start=[[29.5,29.5,0,1],[25,24,-5,0],[20,24,-5,0]]"
LEARNING = {
    *("converged", "cost_per_iteration", "cost_total_start_policy", "policy_iterations"),
    *("learning_collisions", "learning_env_steps", "learning_vehicle_seconds"),
}


def learn(folder: Path, *overrides: str) -> dict:
    folder.mkdir(parents=True, exist_ok=True)
    config = compose([*SHORT, *overrides])
    validate(config)
    return run(config, "fig5_free", folder, [*SHORT, *overrides])


def checked(arguments: Sequence[str]) -> tuple[Path, list[str]]:
    """The checkpoint that is meant, and the command line for Hydra."""
    register()
    program = evaluate.Evaluate()
    line = program.checked(arguments)
    return program.path, line


def fly(folder: Path, *arguments: str) -> dict:
    """`uwirl-evaluate`, in this process."""
    folder.mkdir(parents=True, exist_ok=True)
    path, line = checked(arguments)
    config = compose([text for text in line if not text.startswith("hydra.")])
    return fly_checkpoint(config, "fig5_free", folder, path)


@pytest.fixture(scope="module", autouse=True)
def _no_search() -> Iterator[None]:
    """The search for the best places on the true channel takes longer than all the rest here."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(shadowing, "shadowed_targets", lambda scenario, snr, targets: targets)
        yield


@pytest.fixture(scope="module")
def source(tmp_path_factory) -> Path:
    """One vehicle's run."""
    folder = tmp_path_factory.mktemp("source")
    learn(folder)
    return folder


@pytest.fixture(scope="module")
def pair(tmp_path_factory) -> Path:
    """Two vehicles', with weights of their own."""
    folder = tmp_path_factory.mktemp("pair")
    learn(folder, PAIR)
    return folder


def test_on_its_own_scenario_it_flies_what_the_run_flew(source, tmp_path):
    fly(tmp_path, f"checkpoint={source}")
    metrics = json.loads((tmp_path / "metrics.json").read_text())
    expected = json.loads((source / "metrics.json").read_text())
    # What it says of the learning is the run's alone.
    assert set(metrics.pop("warnings")) < set(expected.pop("warnings"))
    own = {"config_hash", "wall_time_s", "checkpoint", "checkpoint_iteration", "overrides"}
    assert {key: value for key, value in metrics.items() if key not in own} == {
        key: value for key, value in expected.items() if key not in own | LEARNING
    }
    assert metrics["checkpoint"] == str(source / "checkpoints" / "last.pt")
    ours, theirs = (np.load(path / "trajectory.npz") for path in (tmp_path, source))
    assert all(np.array_equal(ours[name], theirs[name]) for name in theirs.files)


def test_the_best_policy_costs_what_its_checkpoint_says(source, tmp_path):
    best = source / "checkpoints" / "best.pt"
    metrics = fly(tmp_path, f"checkpoint={best}")
    assert metrics["cost_total"] == pytest.approx(checkpoint.load(best)["cost_total"], rel=1e-9)


def test_elsewhere_with_more_vehicles_of_another_kind(source, tmp_path):
    metrics = fly(tmp_path, f"checkpoint={source}", OBSTACLE, PAIR, "vehicle=bluerov2_heavy", "safety.mass_upper_kg=36")
    assert (metrics["status"], metrics["error"]) == ("complete", None)
    assert len(metrics["final_position_m"]) == len(metrics["estimate_K_dB"]) == 2
    assert metrics["min_obstacle_clearance_m"] < 20.0


def test_in_random_layouts(source, tmp_path):
    layouts = ("experiment=random_layouts", "scenario.layouts.count=2", "scenario.layouts.kinds=[sparse]")
    metrics = fly(tmp_path, f"checkpoint={source}", *layouts, "scenario.duration_s=1")
    assert metrics["worlds"] == 2


@pytest.mark.parametrize(
    ("arguments", "error"),
    [
        ([TRIO], "last.pt: channel estimates of 2 vehicles, shape (2, 5); 3 vehicles need (3, 5) or (1, 5)"),
        (["basis=error_velocity"], "last.pt: 17 weights of another basis, 8 are needed; only in the checkpoint: g_par"),
    ],
)
def test_what_does_not_fit_is_refused(pair, tmp_path, arguments, error):
    metrics = fly(tmp_path, f"checkpoint={pair}", *arguments)
    assert metrics["status"] == "failed"
    assert metrics["error"].startswith("CheckpointError: ")
    assert error in metrics["error"]


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ([], ConfigError, "checkpoint: give one file or run folder"),
        (["checkpoint=a", "checkpoint=b"], ConfigError, "checkpoint: give one file or run folder"),
        (["checkpoint=nowhere"], CheckpointError, "nowhere: cannot be read"),
        (["checkpoint={}", "planner=pd"], ConfigError, "planner: is the one that learned"),
        (["checkpoint={}", "init_from=x"], ConfigError, "init_from: has no use in an evaluation"),
        (["checkpoint={}", "cost.beta_1=-1"], ConfigError, "cost.beta_1: must be greater than 0"),
    ],
)
def test_bad_command_lines_are_refused(source, arguments, error, message):
    with pytest.raises(error, match=message):
        checked([argument.format(source) for argument in arguments])


def test_the_command(source, tmp_path, monkeypatch, capsys, call):
    monkeypatch.chdir(tmp_path)
    call(evaluate.main, f"checkpoint={source}")
    (folder,) = (tmp_path / "outputs" / "evaluation").iterdir()
    assert json.loads((folder / "metrics.json").read_text())["status"] == "complete"
    with pytest.raises(SystemExit) as caught:
        call(evaluate.main, "checkpoint=nowhere")
    assert caught.value.code == 2
    assert capsys.readouterr().err == "uwirl-evaluate: nowhere: cannot be read (No such file or directory)\n"


def test_a_run_starts_from_anothers_estimate_and_weights(source, tmp_path):
    metrics = learn(tmp_path, f"init_from={source}", "channel.zeta_dB=1", "seed=5")
    before = checkpoint.load(source / "checkpoints" / "last.pt")
    after = checkpoint.load(tmp_path / "checkpoints" / "last.pt")
    assert torch.equal(after["learner"]["start"], before["actor"])
    assert torch.equal(after["estimate"]["value"], before["estimate"]["value"])
    assert metrics["cost_total_start_policy"] < json.loads((source / "metrics.json").read_text())["cost_total"] * 1.05


@pytest.mark.parametrize(("part", "others"), [("weights", (PAIR,)), ("estimate", ("planner=pd", PAIR))])
def test_one_part_serves_two_vehicles(source, tmp_path, part, others):
    lines = [text for text in SHORT if "max_time" not in text or "planner=pd" not in others]
    config = compose([*lines, f"init_from={source}", f"init_from_parts=[{part}]", *others])
    validate(config)
    metrics = run(config, "fig5_free", tmp_path)
    assert metrics["status"] == "complete"
    before = checkpoint.load(source / "checkpoints" / "last.pt")
    if part == "estimate":
        assert metrics["estimate_K_dB"] == [float(before["estimate"]["value"][0, 0])] * 2
    else:
        assert metrics["estimate_K_dB"][0] != metrics["estimate_K_dB"][1]
        start = checkpoint.load(tmp_path / "checkpoints" / "last.pt")["learner"]["start"]
        assert torch.equal(start, before["actor"].expand(2, -1))


def test_two_sets_of_weights_do_not_serve_three_vehicles(pair, tmp_path):
    metrics = learn(tmp_path, f"init_from={pair}", "init_from_parts=[weights]", TRIO)
    assert metrics["status"] == "failed"
    assert metrics["error"].endswith(
        "last.pt: actor weights (2, 17), where (3, 17) or one set for all, (1, 17), are needed (experience=parallel "
        "learns one)"
    )


def test_the_hash_tells_what_a_run_starts_from_but_not_where_that_lies(source, pair, tmp_path):
    copy = tmp_path / "copy.pt"
    for end in ("", ".sha256"):
        original = source / "checkpoints" / f"last.pt{end}"
        copy.with_name(copy.name + end).write_bytes(original.read_bytes())
    from uwirl.runs.saving import Origin

    def hashed(place: Path | None) -> str:
        config = compose([*SHORT, f"init_from={place or 'null'}"])
        return Origin.of(config).config_hash(config)

    assert hashed(copy) == hashed(source)
    assert len({hashed(source), hashed(pair), hashed(None)}) == 3


def test_flags_come_before_all_overrides_or_hydra_reads_neither(source):
    path, line = checked(["seed=1,2", f"checkpoint={source}", "scenario.duration_s=3", "-m"])
    assert path == source / "checkpoints" / "last.pt"
    assert line == ["-m", *SHORT[:2], *QUIET, "seed=1,2", "scenario.duration_s=3", evaluate.FOLDER]


def test_a_sweeps_names_are_checked_first(source):
    with pytest.raises(ConfigError, match=r"sed: no such key.*did you mean 'seed'"):
        checked(["-m", f"checkpoint={source}", "sed=1,2"])


def test_another_class_takes_its_settings_along(source, monkeypatch):
    saved = ["vehicle.target=mine.Worn", "+vehicle.settings.dead_zone=2", "seed=1"]
    loaded = learning_file.load(source / "checkpoints" / "last.pt")
    monkeypatch.setattr(learning_file, "load", lambda path: loaded | {"overrides": saved})
    _, line = checked([f"checkpoint='{source}'", "vehicle.target=null"])
    assert line == ["seed=1", "vehicle.target=null", evaluate.FOLDER]


@pytest.mark.parametrize("arguments", [[], ["--config-dir", "."], ["seed=1"]])
def test_a_checkpoint_is_asked_for(arguments):
    with pytest.raises(ConfigError, match="checkpoint: give one file or run folder"):
        checked(arguments)


def test_help_is_its_own(capsys):
    with pytest.raises(SystemExit) as ended:
        checked(["--help"])
    assert ended.value.code == 0
    assert capsys.readouterr().out.startswith("uwirl-evaluate: fly what was learned")
