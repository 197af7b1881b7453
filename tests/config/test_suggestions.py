"""Typos and impossible values: the key that is named, and what is suggested or which rule is told."""

from __future__ import annotations

import re

import pytest

from uwirl.config.checks import ConfigError
from uwirl.config.compose import composed, to_object
from uwirl.config.estimate_schema import register
from uwirl.config.overrides import key_of
from uwirl.config.suggestions import similar
from uwirl.config.validate import validate

TYPOS = [
    # A key.
    (["channel.zeta=3"], "channel.zeta", "did you mean 'channel.zeta_dB'?"),
    (["channel.zeta=3"], "channel.zeta", "(channel has K_dB, n, N0_dB"),
    (["channel.k_db=3"], "channel.k_db", "did you mean 'channel.K_dB'?"),
    (["channel.K=3"], "channel.K", "did you mean 'channel.K_dB'?"),
    (["channel.bandwith_khz=3"], "channel.bandwith_khz", "did you mean 'channel.bandwidth_khz'?"),
    (["channel.salinity_ppt=3"], "channel.salinity_ppt", "did you mean 'channel.water.salinity_ppt'?"),
    (["channel.water.temperature=3"], "channel.water.temperature", "did you mean 'channel.water.temperature_C'?"),
    (["scenario.sensor=4"], "scenario.sensor", "did you mean 'scenario.sensors'?"),
    (["scenario.duration=80"], "scenario.duration", "did you mean 'scenario.duration_s'?"),
    (
        ["scenario.obstacles=[{center_m:[1,2],radus_m:3}]"],
        "scenario.obstacles.radus_m",
        "'scenario.obstacles.radius_m'",
    ),
    (["scenario.obstacles.0.radus_m=3"], "scenario.obstacles.0.radus_m", "did you mean 'scenario.obstacles.0.radius"),
    (["chanel.n=3"], "chanel.n", "did you mean 'channel.n'?"),
    (["sed=3"], "sed", "did you mean 'seed'?"),
    (["zeta_dB=3"], "zeta_dB", "did you mean 'channel.zeta_dB'?"),
    (["updates=3"], "updates", "did you mean 'planner.updates'?"),
    (["planner.position_gain=[1,1,1,1]"], "planner.position_gain", "only with planner=pd or planner=potential_field"),
    (["planner.position_gain=[1,1,1,1]"], "planner.position_gain", "did you mean 'baseline.position_gain'"),
    (
        ["basis=error_quadratic", "basis.length_scales_m=[2]"],
        "basis.length_scales_m",
        "only with basis=geodesic or basis=",
    ),
    (["solver.kappa=0.9"], "solver.kappa", "only with solver=rls_forgetting or solver=rls_paper"),
    (["channel.n.x=3"], "channel.n.x", "channel.n is no group of settings, it must be a number"),
    # A key added with + or ++, which Hydra lets pass.
    (["+channel.zeta=3"], "channel.zeta", "did you mean 'channel.zeta_dB'?"),
    (["++channel.water.salinity=3"], "channel.water.salinity", "did you mean 'channel.water.salinity_ppt'?"),
    (["+sede=3"], "sede", "did you mean 'seed'?"),
    (["+ablaton=no_map"], "ablaton", "did you mean 'ablation'?"),
    (["+chanel.zeta_dB=3"], "chanel", "did you mean 'channel'?"),
    (["+nothing.like.it=3"], "nothing", "no such key (there are scenario, channel"),
    (["+channel.zeta_dB=3"], "channel.zeta_dB", "is there already; drop the +"),
    (["+scenario.obstacles.0.colour=red"], "scenario.obstacles.0.colour", "has center_m, radius_m, influence_m"),
    # A group.
    (["chanel=paper"], "chanel", "did you mean 'channel'?"),
    (["experimnt=fig5_free"], "experimnt", "did you mean 'experiment'"),
    (["baseline=pd"], "baseline", "choose it with planner@baseline=pd"),
    (["planner@basline=pd"], "planner@basline", "did you mean 'planner' or 'planner@baseline'?"),
    (["planer@baseline=pd"], "planer", "no such group; did you mean 'planner'"),
    (["+channel=paper"], "channel", "is chosen already; drop the +"),
    # An option.
    (["channel=papr"], "channel", "is none of acoustic_24khz, paper; did you mean 'channel=paper'?"),
    (["ablation=no_shadow"], "ablation", "did you mean 'ablation=no_shadowing'?"),
    (["experiment=fig5"], "experiment", "did you mean 'experiment=fig5_free' or 'experiment=fig5_single'?"),
    (["planner@baseline=irk"], "planner@baseline", "did you mean 'planner@baseline=irl'?"),
    (["ablation=[no_map,no_safety]"], "ablation", "takes one option, got the list [no_map,no_safety]"),
    (["channel=schema"], "channel", "'schema' is none of acoustic_24khz, paper"),
    (["channel=null"], "channel", "null is none of acoustic_24khz, paper"),
    (["scenario=5"], "scenario", "5 is none of single_relay"),
    (["hydra/job_logging=uwrl"], "hydra/job_logging", "did you mean 'hydra/job_logging=uwirl'?"),
    # A type.
    (["seed=abc"], "seed", "must be a whole number, got abc"),
    (["seed="], "seed", "must be a whole number, got nothing"),
    (["seed=null"], "seed", "must be a whole number, got null"),
    (["planner.updates=1.5"], "planner.updates", "must be a whole number, got 1.5"),
    (["channel.n=five"], "channel.n", "must be a number, got five"),
    (["logging.figures=maybe"], "logging.figures", "must be true or false, got maybe"),
    (["channel.frequency_khz=high"], "channel.frequency_khz", "must be a number, or null, got high"),
    (["cost.R=3"], "cost.R", "must be a list of numbers, got 3"),
    (["cost.R=[1,1,a,1]"], "cost.R.2", "is an entry of a list of numbers"),
    (["basis.length_scales_m=[1,[2]]"], "basis.length_scales_m.1", "is an entry of a list of numbers, which holds no"),
    (["scenario.obstacles=${seed}"], "scenario.obstacles", "must be a list of groups of settings, but refers to 0"),
    (["scenario.start=5"], "scenario.start", "must be a list, got 5"),
    (["channel.water=warm"], "channel.water", "is a group of settings, which takes no single value"),
    (["scenario.obstacles.5.radius_m=3"], "scenario.obstacles.5", "is beyond the list's 2 entries"),
    (["cost.R.7=3"], "cost.R.7", "is beyond the list's entries"),
    # A missing value, or one that leads nowhere.
    (["seed=???"], "seed", "has no value; give it one with seed=VALUE"),
    (["scenario.obstacles=[{center_m:[1,2],radius_m:3}]"], "scenario.obstacles.0.influence_m", "has no value"),
    (["seed=${nowhere}"], "seed", "refers to what is not there: Interpolation key 'nowhere' not found"),
    (["scenario.layouts.count=3"], "scenario.layouts", "is null here, so none of it can be set; experiment=random_lay"),
    (["scenario.layouts={count:3}"], "scenario.layouts", "is null here"),
    # What cannot be left out.
    (["~channel"], "channel", "cannot be left out; choose one of channel=acoustic_24khz, paper"),
    (["~ablation"], "ablation", "cannot be left out; choose ablation=none"),
    (["~experiment"], "experiment", "cannot be left out"),
    (["~seed"], "seed", "cannot be deleted, every run needs it; set it with seed=VALUE"),
    (["~channel.zeta_dB"], "channel.zeta_dB", "cannot be deleted"),
    # What cannot be read.
    (["seed"], "seed", "is no setting; write KEY=VALUE, as in seed=3"),
    (["seed:3"], "seed:3", "is no setting"),
    (["=3"], "=3", "names no key; write KEY=VALUE"),
    (["scenario.start=[[1,2"], "scenario.start", "cannot be read"),
    (["device=[cpu"], "device", "quote text with other signs than"),
    (["seed=1,2"], "seed", "is a sweep over several values; add --multirun"),
    (["channel=paper,acoustic_24khz"], "channel", "add --multirun"),
    # An ablation that is undone: which, where, and both values.
    (["ablation=least_squares", "estimator=oracle"], "estimator", "'oracle' undoes ablation=least_squares, which sets"),
    (["ablation=least_squares", "estimator.name=oracle"], "estimator.name", "undoes ablation=least_squares"),
    (
        ["ablation=no_shadowing", "channel.zeta_dB=3"],
        "channel.zeta_dB",
        "3.0 undoes ablation=no_shadowing, which sets 0.0",
    ),
    (["channel.zeta_dB=3", "ablation=no_shadowing"], "channel.zeta_dB", "undoes ablation=no_shadowing"),
    (["ablation=no_map", "guidance=geodesic"], "guidance", "'geodesic' undoes ablation=no_map, which sets 'straight'"),
    (["ablation=paper_obstacle_cost", "safety=barrier"], "safety", "'barrier' undoes ablation=paper_obstacle_cost"),
    (
        ["ablation=unbounded", "++solver.bounded=true"],
        "solver.bounded",
        "True undoes ablation=unbounded, which sets False",
    ),
    (["ablation=no_relabel", "experience=parallel"], "experience.relabel", "(in ablation/no_relabel)"),
    # An impossible value; tests/config/test_validate.py holds every rule.
    (["channel.n=-1"], "channel.n", "must be greater than 0, got -1"),
    (["seed=-1"], "seed", "must lie in [0, 2^63), got -1"),
    (["estimator.name=orakle"], "estimator.name", "did you mean 'oracle'?"),
    (["safety.name=barrier"], "safety.name", "choose it with safety=barrier"),
    (["scenario.sensors=2"], "scenario.sensors", "at least 3 are needed"),
]
ALLOWED = [
    ["++channel.zeta_dB=1"],
    ["++seed=3"],
    ["channel.water.pH=7.9"],
    ["ablation=least_squares", "estimator=least_squares"],
    ["ablation=no_shadowing", "channel.zeta_dB=0"],
    ["ablation=rls_forgetting", "solver.kappa=0.99"],
    ["ablation=parallel", "experience.worlds=30"],
    ["hydra.run.dir=somewhere", "hydra.job.chdir=false", "+hydra.job.env_set.A=b"],
    ["device='cpu'"],
]
ESTIMATE = [
    (["map.spacing=3"], "map.spacing", "did you mean 'map.spacing_m'?"),
    (["channel.zeta=3"], "channel.zeta", "did you mean 'channel.zeta_dB'?"),
    (["+dat=log.csv"], "dat", "did you mean 'data'?"),
    (["estimator=irl"], "estimator", "'irl' is none of custom, disk, generalized_least_squares"),
    (["planner=pd"], "planner", "is no group to choose from here (there are channel, estimator, logging)"),
    (["max_readings=many"], "max_readings", "must be a whole number, got many"),
    (["~estimator"], "estimator", "cannot be left out"),
    (["readings.csv"], "readings.csv", "is no setting"),
]


def ids(rows):
    return [" ".join(row[0]) for row in rows]


@pytest.mark.parametrize(("overrides", "key", "fragment"), TYPOS, ids=ids(TYPOS))
def test_one_message(make_config, overrides: list[str], key: str, fragment: str):
    with pytest.raises(ConfigError) as caught:
        validate(make_config(*overrides))
    message = str(caught.value)
    assert caught.value.key == key
    assert message.startswith(f"{key}: ")
    assert fragment in message
    assert "\n" not in message
    assert len(message) < 600


@pytest.mark.parametrize("overrides", ALLOWED, ids=" ".join)
def test_what_may_be_said(make_config, overrides: list[str]):
    validate(make_config(*overrides))


@pytest.mark.parametrize(("overrides", "key", "fragment"), ESTIMATE, ids=ids(ESTIMATE))
def test_one_message_of_estimate(overrides: list[str], key: str, fragment: str):
    register()
    with pytest.raises(ConfigError) as caught:
        to_object(composed("estimate", overrides))
    assert caught.value.key == key
    assert fragment in str(caught.value)


@pytest.mark.parametrize(
    ("name", "content", "override", "key", "fragment"),
    [
        (
            "channel/lake",
            "defaults: [paper]\nzeta: 3",
            "channel=lake",
            "channel.zeta",
            "(in channel/lake); did you mean",
        ),
        ("channel/lake", "defaults: [paper]\nn: x", "channel=lake", "channel.n", "must be a number (in channel/lake)"),
        ("channel/lake", "n: [", "channel=lake", "channel", "lake.yaml cannot be read: while parsing"),
        ("channel/lake", "n: 2", "channel=lak", "channel", "did you mean 'channel=lake'?"),
        (
            "ablation/calm",
            "# @package _global_\nscenario: {current_std_mps: 0.0}",
            "ablation=calm scenario.current_std_mps=0.1",
            "scenario.current_std_mps",
            "0.1 undoes ablation=calm, which sets 0.0",
        ),
        (
            "experiment/mine",
            "# @package _global_\ndefaults:\n- override /channel: papr",
            "experiment=mine",
            "channel",
            "'papr' is none of acoustic_24khz, paper; did you mean 'channel=paper'?",
        ),
    ],
)
def test_files_of_the_user(tmp_path, name: str, content: str, override: str, key: str, fragment: str):
    path = tmp_path / f"{name}.yaml"
    path.parent.mkdir()
    path.write_text(content + "\n")
    with pytest.raises(ConfigError) as caught:
        to_object(composed("config", override.split(), str(tmp_path)))
    assert caught.value.key == key
    assert fragment in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("name", "names", "nearest"),
    [
        ("zeta", ["rho_dB", "zeta_dB", "n"], ["zeta_dB"]),
        ("K_DB", ["N0_dB", "K_dB"], ["K_dB"]),
        ("fig5", ["fig4_snr", "fig5_free", "fig5_single"], ["fig5_free", "fig5_single"]),
        ("nothing", ["alike"], []),
        ("", ["alike"], []),
    ],
)
def test_similar(name: str, names: list[str], nearest: list[str]):
    assert similar(name, names)[: max(len(nearest), 1)] == nearest


PRINTED = re.compile(r"(?:with|as in|choose|mean|or) '?(~?\+{0,2}[\w./@]+=[\w./-]+)")
VALUES = {"scenario.obstacles.0.influence_m": "9", "seed": "3", "safety.mass_lower_kg": "10"}


@pytest.mark.parametrize(
    "overrides", [row[0] for row in TYPOS if row[0][0] not in ("seed", "=3", "seed:3")], ids=lambda row: " ".join(row)
)
def test_advice_works_as_printed(make_config, overrides: list[str]):
    with pytest.raises(ConfigError) as caught:
        validate(make_config(*overrides))
    for advice in PRINTED.findall(str(caught.value)):
        key = key_of(advice)
        # In the place of what was wrong.
        others = [word for word in overrides if key_of(word) not in (key, caught.value.key) or word.endswith("]")]
        make_config(*others, advice.replace("VALUE", VALUES.get(key, "1")))
