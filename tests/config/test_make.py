"""One way to make an object: ours and the user's own, from a section and what is given besides."""

from __future__ import annotations

import dataclasses
import json
import sys
from enum import Enum
from typing import Any

import pytest
import torch

from uwirl.config.checks import ConfigError, MadeConfig
from uwirl.config.compose import compose, folder
from uwirl.config.make import make
from uwirl.config.motion_schema import PdConfig, PlannerConfig
from uwirl.config.schema import BasisConfig, Config, EstimatorConfig, VehicleConfig
from uwirl.world.absorption import Water
from uwirl.world.acoustics import LinkBudget

MODULE = """
class Gains(list):
    def __init__(self, *given, **named):
        super().__init__([given, named])
    def fit(self, env, estimate): ...

class Rude(Gains):
    def __init__(self):
        raise TypeError("not today")

def function(readings, budget, n=2.0):
    return readings, budget, n
"""


@pytest.fixture(autouse=True)
def module(tmp_path, monkeypatch):
    (tmp_path / "gains.py").write_text(MODULE)
    monkeypatch.setattr(sys, "path", sys.path.copy())
    monkeypatch.chdir(tmp_path)
    yield
    sys.modules.pop("gains", None)


def test_an_object_of_ours_is_made_from_its_section(make_config):
    config = make_config("channel=acoustic_24khz").channel
    water = Water(temperature_C=4.0)
    made = make(config, water=water)
    assert type(made) is LinkBudget
    assert made.water is water
    assert (made.N0_dB, made.absorption) == (config.N0_dB, "thorp")


def test_keys_settings_and_what_is_given_arrive_as_they_are():
    config = PdConfig(
        target="gains.Gains", name="mine", settings={"more": [1, {"a": 2}]}, position_gain=[1.0], velocity_gain=[2.0]
    )
    tensor = torch.ones(2)
    given, named = make(config, tensor, calibration_s=3.0, saturation_m=tensor)
    assert given[0] is tensor
    assert named.pop("saturation_m") is tensor
    # Names and lists are Python's own.
    assert named == {
        "more": [1, {"a": 2}],
        "position_gain": [1.0],
        "velocity_gain": [2.0],
        "calibration_s": 3.0,
    }
    assert [type(value) for value in named["more"]] == [int, dict]


def test_settings_may_hold_objects_of_their_own():
    config = PlannerConfig(name="mine", target="gains.Gains", settings={"part": {"_target_": "gains.Gains", "k": 2}})
    _, named = make(config)
    assert named["part"] == [(), {"k": 2}]
    with pytest.raises(ConfigError, match=r"planner.settings: .*nowhere"):
        make(PlannerConfig(name="mine", target="gains.Gains", settings={"part": {"_target_": "nowhere.X"}}))


def test_a_function_with_its_settings_is_one_already():
    made = make(EstimatorConfig(name="mine", target="gains.function", settings={"n": 5}))
    assert made("readings", budget="budget") == ("readings", "budget", 5)


def test_null_stands_for_uwirls_own(make_config):
    config = make_config("vehicle.target=null").vehicle
    assert config.target is None
    assert type(make(config, dtype=torch.float64)).__name__ == "Vehicle"


@pytest.mark.parametrize(
    ("section", "message"),
    [
        (PlannerConfig(name="mine"), "planner.target: names no class; give package.module.Class"),
        (PlannerConfig(name="mine", target="gains.Nothing"), "planner.target: gains has no 'Nothing'"),
        (BasisConfig(name="mine", target="nowhere.X"), "basis.target: no module 'nowhere'"),
        (BasisConfig(name="mine", target="gains.Gains"), "basis.target: gains.Gains is no uwirl.motion.features"),
    ],
)
def test_what_cannot_be_made_is_one_message(section: MadeConfig, message: str):
    with pytest.raises(ConfigError) as caught:
        make(section)
    assert str(caught.value).startswith(message)
    assert "\n" not in str(caught.value)


def test_what_a_class_raises_itself_is_not_hidden():
    with pytest.raises(TypeError, match="not today"):
        make(PlannerConfig(name="mine", target="gains.Rude"))


OPTIONS = [
    (field.name, path.stem)
    for field in dataclasses.fields(Config)
    for path in sorted((folder() / field.name).glob("*.yaml"))
    if field.name not in ("scenario", "logging") and path.stem not in ("custom", "own")
]


def test_every_option_of_ours_says_its_class():
    assert len({group for group, _ in OPTIONS}) == 10
    for group, option in OPTIONS:
        config = compose([f"{group}={option}"])
        assert str(getattr(config, group).target).startswith("uwirl."), (group, option)
        assert getattr(config, group).settings == {}


@pytest.mark.parametrize("schema", [VehicleConfig, PdConfig], ids=lambda schema: schema.__name__)
def test_values_are_all_keys_but_those_of_the_way_to_make_it(schema: type[MadeConfig]):
    config = schema()
    names = {field.name for field in dataclasses.fields(config)}
    assert names - set(config.values()) == {"target", "settings", "name"} & names


def test_choices_are_plain_text(make_config):
    """As YAML, JSON and checkpoints take it."""

    def leaves(value: Any) -> list[Any]:
        if isinstance(value, dict | list):
            return [leaf for item in (value.values() if isinstance(value, dict) else value) for leaf in leaves(item)]
        return [value]

    values = dataclasses.asdict(make_config("experiment=random_layouts", "channel=acoustic_24khz"))
    assert not [leaf for leaf in leaves(values) if isinstance(leaf, Enum)]
    assert json.loads(json.dumps(values))["channel"]["absorption"] == "thorp"
