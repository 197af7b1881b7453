"""Composition: every shipped file composes and validates, what beats what, unknown keys, and no torch."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import asdict
from pathlib import Path

import hydra
import pytest
from omegaconf import OmegaConf

from uwirl.config.compose import compose, composed, folder, searching
from uwirl.config.schema import register
from uwirl.config.validate import ConfigError, validate

GROUPS = [
    "experiment",
    "ablation",
    "scenario",
    "channel",
    "vehicle",
    "estimator",
    "basis",
    "cost",
    "safety",
    "guidance",
    "solver",
    "planner",
    "experience",
    "logging",
]
FILES = [(group, path.stem) for group in GROUPS for path in sorted((folder() / group).glob("*.yaml"))]
NAMED = ["estimator", "basis", "safety", "guidance", "solver", "planner", "experience"]

# What a choice asks for besides.
TARGETS = {
    "basis": ["basis.target=uwirl.motion.features.LinkFrameBasis", "+basis.settings.length_scales_m=[2]"],
    "estimator": ["estimator.target=uwirl.snr.estimators.disk"],
    "planner": ["planner.target=uwirl.motion.irl_planner.IrlPlanner"],
}
NEEDS = {
    ("basis", "geodesic"): ["experience=parallel"],
    **{(group, name): words for group, words in TARGETS.items() for name in ("custom", "own")},
}


@pytest.mark.parametrize(("group", "name"), FILES, ids=["/".join(file) for file in FILES])
def test_every_file_composes_and_validates(make_config, group: str, name: str):
    config = make_config(f"{group}={name}", *NEEDS.get((group, name), []))
    validate(config)
    if group in NAMED:
        assert getattr(config, group).name == name


def test_every_group_is_covered():
    groups = {path.name for path in folder().iterdir() if path.is_dir()}
    assert groups - {"hydra"} == set(GROUPS)


def test_every_group_has_files():
    assert {group for group, _ in FILES} == set(GROUPS)


def test_likelihood_is_the_default(make_config):
    assert make_config().estimator.name == "maximum_likelihood"
    assert not make_config().estimator.robust


@pytest.mark.parametrize(
    "words",
    [
        [],
        ["seed=3", "scenario.start.0.1=2", "scenario.obstacles.1.radius_m=1.5", "+planner.settings.a={b: [1, 2]}"],
        ["planner.max_time_s=900", "experience=parallel", "++seed=4", "channel.frequency_khz=null"],
        ["experiment=random_layouts", "scenario.layouts.kinds=[ring]", "ablation=no_map", "channel.water.pH=7.5"],
        ["scenario.obstacles=[{center_m: [1, 2], radius_m: 3, influence_m: 4}]", "resume='a=b,c'"],
        ["hydra.job.chdir=true", "hydra/job_logging=default", "channel.water={pH: 7.5}"],
        ["planner@baseline=irl", "baseline.updates=2", "planner.start_gain=${cost.beta_1}", "hydra.run.dir=x"],
    ],
    ids=" ".join,
)
def test_what_is_composed_is_what_hydra_composes(words: list[str]):
    register()
    with searching():
        theirs = hydra.compose("config", words, return_hydra_config=True)
    ours = composed("config", words, whole=True)
    both = [OmegaConf.to_container(config) for config in (ours, theirs)]
    for values in both:
        # What was said, and where Hydra ran.
        values["hydra"] |= {"overrides": None, "job": values["hydra"]["job"]["chdir"], "runtime": None}
    assert both[0] == both[1]


ABLATIONS = [name for group, name in FILES if group == "ablation" and name != "none"]
# What a choice declares by interpolation in other files.
FOLLOWS = {"parallel": ["planner.max_time_s"]}


@pytest.mark.parametrize("channel", ["paper", "acoustic_24khz"])
@pytest.mark.parametrize("ablation", ABLATIONS)
def test_an_ablation_changes_what_it_declares_and_nothing_else(make_config, ablation: str, channel: str):
    # Composed already, by the test above, where the channel is the default.
    words = [] if channel == "paper" else [f"channel={channel}"]
    plain, ablated = (asdict(make_config(*words, f"ablation={name}")) for name in ("none", ablation))
    assert ablated != plain
    file = OmegaConf.to_container(OmegaConf.load(folder() / "ablation" / f"{ablation}.yaml"))
    choices = [next(iter(entry)).removeprefix("override /") for entry in file.pop("defaults", [])]
    # Of a group of which another option is chosen everything may change, of values those alone.
    allowed = [f"{group}." for group in choices] + FOLLOWS.get(ablation, []) + sorted(leaves(file))
    changed = {key for key in leaves(plain) | leaves(ablated) if leaf(plain, key) != leaf(ablated, key)}
    assert {key for key in changed if not key.startswith(tuple(allowed))} == set()
    for key in leaves(file):
        assert leaf(ablated, key) == leaf(file, key) != leaf(plain, key)
    for group in choices:
        assert any(key.startswith(f"{group}.") for key in changed)


def leaves(values: dict, prefix: str = "") -> set[str]:
    """Dotted names of whatever is no dictionary."""
    parts = [leaves(v, f"{prefix}{k}.") if isinstance(v, dict) else {f"{prefix}{k}"} for k, v in values.items()]
    return set().union(*parts)


def leaf(values: dict, key: str):
    for name in key.split("."):
        values = values.get(name, "absent")
    return values


def test_parallel_raises_the_time_limit(make_config):
    assert make_config().planner.max_time_s < 7200.0
    assert make_config("experience=parallel").planner.max_time_s == 7200.0


@pytest.mark.parametrize(
    "overrides",
    [["experience=parallel", "planner.max_time_s=900"], ["planner.max_time_s=900", "experience=parallel"]],
)
def test_command_line_beats_parallels_limit(overrides: list[str]):
    assert compose(overrides).planner.max_time_s == 900.0


def test_command_line_beats_the_experiments_choice(make_config):
    chosen, overridden = make_config(), make_config("channel=acoustic_24khz", "experiment=fig5_single")
    assert chosen.channel.absorption == "none"
    assert overridden.channel.absorption == "thorp"
    assert overridden.channel.frequency_khz == 24.0
    # Nothing else moves.
    overridden.channel = chosen.channel
    assert overridden == chosen


@pytest.mark.parametrize(
    ("override", "named"),
    [
        ("scenario.duration=80", "scenario.duration"),
        ("speed=3", "speed"),
        ("planner=dp", "planner"),
        ("vessel=bluerov2", "vessel"),
        ("planner.position_gain=[1,1,1,1]", "planner.position_gain"),  # the baseline's, not the learner's
        ("scenario.dt_s=soon", "scenario.dt_s"),
        ("scenario.start=5", "scenario.start"),
    ],
)
def test_unknown_keys_and_wrong_types_are_refused(override: str, named: str):
    with pytest.raises(ConfigError) as caught:
        compose([override])
    assert caught.value.key == named


def test_configuration_imports_no_torch():
    # In a fresh interpreter: this one has long imported torch.
    program = (
        "import json, sys\n"
        "from uwirl.config.compose import compose\n"
        "from uwirl.config.validate import ConfigError, validate\n"
        "validate(compose())\n"
        "print(json.dumps([name for name in ('torch', 'numpy', 'hydra') if name in sys.modules]))\n"
    )
    result = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    loaded = json.loads(result.stdout)
    assert "hydra" in loaded
    assert not {"torch", "numpy"} & set(loaded)


def own_scenario(tmp_path: Path, text: str) -> str:
    """scenario=bay, in a folder for --config-dir."""
    (tmp_path / "scenario").mkdir()
    (tmp_path / "scenario" / "bay.yaml").write_text(f"defaults: [single_relay]\n{text}")
    return str(tmp_path)


BAY = "obstacles: [{center_m: [0, 5], radius_m: 1, influence_m: 4}]\n"
OTHER = "[{center_m: [1, 7], radius_m: 1, influence_m: 4}]"


@pytest.mark.parametrize("line", ["scenario=bay", "scenario=bay experiment=none", "scenario=bay experiment=fig5_free"])
def test_a_named_scenario_is_flown_as_it_is(tmp_path: Path, line: str):
    config = compose(line.split(), own_scenario(tmp_path, BAY))
    assert [obstacle.center_m for obstacle in config.scenario.obstacles] == [[0.0, 5.0]]


def test_a_named_scenario_without_obstacles_has_none(tmp_path: Path):
    assert compose(["scenario=bay"], own_scenario(tmp_path, "depth_m: 30\n")).scenario.obstacles == []


@pytest.mark.parametrize(
    ("line", "message"),
    [
        (
            "scenario=bay experiment=fig5_single",
            "scenario: scenario.obstacles of scenario=bay is replaced by experiment=",
        ),
        ("scenario=bay experiment=random_layouts", "scenario: scenario.obstacles of scenario=bay is replaced by exp"),
        (
            "scenario=bay experiment=fig6_pair",
            "scenario: scenario.start of scenario=bay is replaced by experiment=fig6",
        ),
        # A file with keys of the whole configuration.
        (
            "vehicle=bluerov2_heavy experiment=random_layouts",
            "vehicle: scenario.duration_s of vehicle=bluerov2_heavy is replaced by experiment=random_layouts, which",
        ),
    ],
)
def test_an_experiment_that_replaces_what_is_named_is_refused(tmp_path: Path, line: str, message: str):
    with pytest.raises(ConfigError) as caught:
        compose(line.split(), own_scenario(tmp_path, BAY + "duration_s: 60\n"))
    assert str(caught.value).startswith(message)


def test_values_of_the_command_line_and_of_an_ablation_replace_both(tmp_path: Path):
    own = own_scenario(tmp_path, BAY)
    for words in (["scenario=bay", "experiment=fig5_single"], ["scenario=single_relay", "experiment=fig5_single"]):
        config = compose([*words, f"scenario.obstacles={OTHER}"], own)
        assert [obstacle.center_m for obstacle in config.scenario.obstacles] == [[1.0, 7.0]]
    assert compose(["experience=virtual_links", "ablation=no_relabel"]).experience.relabel == 0
