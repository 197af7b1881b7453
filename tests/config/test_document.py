"""docs/configuration.md is what the schemas say, and they say something about every key."""

from __future__ import annotations

import dataclasses
import re
import subprocess
import sys

import pytest
from write_configuration import PATH, Setting, document, settings

from uwirl.config import estimate_schema, motion_schema, schema, world_schema
from uwirl.config.schema import ScenarioConfig

# What endings of names stand for; every other number says its unit, if it has one, behind the field.
UNITS = {
    "_rad_s": "rad/s",
    "_m": "m",
    "_s": "s",
    "_mps": "m/s",
    "_dB": "dB",
    "_khz": "kHz",
    "_kg": "kg",
    "_N": "N",
    "_kbps": "kbit/s",
}
MODULES = (schema, motion_schema, world_schema, estimate_schema)
SCHEMAS = sorted({c for m in MODULES for c in vars(m).values() if dataclasses.is_dataclass(c)}, key=str)


def test_page_is_up_to_date():
    assert PATH.read_text(encoding="utf-8") == document(), "run `python docs/write_configuration.py`"


def test_page_holds_every_key_and_its_default():
    page = PATH.read_text(encoding="utf-8")
    assert "| `scenario.dt_s` | number | `0.05` | s; step of control and of integration (RK4) |" in page
    assert "| `planner.max_time_s` | number | `600.0` | s; T_max,2, vehicle time |" in page
    assert "| `safety.k_1` | number | `2.0` | 1/s;" in page
    assert "| `scenario.obstacles[].center_m` | list of numbers |  | m; [x, y] of a" in page
    assert "| `map.spacing_m` | number, or null | `null` | m; between nodes" in page
    assert "| `scenario.layouts.half_width_m` | number | `30.0` | m; of the square" in page
    assert "schema" not in page.replace("schemas", "")


@pytest.mark.parametrize("owner", SCHEMAS, ids=[schema.__name__ for schema in SCHEMAS])
def test_every_key_says_its_unit(owner: type):
    for setting in settings(owner):
        assert setting.comment, f"{owner.__name__}.{setting.key} says nothing"
        unit = next((unit for ending, unit in UNITS.items() if setting.key.endswith(ending)), None)
        if unit is not None:
            assert re.match(rf"{re.escape(unit)}([;, ]|$)", setting.comment), setting


def test_comments_are_the_fields_own():
    comments = {setting.key: setting.comment for setting in settings(ScenarioConfig)}
    assert comments["start"].startswith("eta of each vehicle, [x, y, z, psi]")
    assert comments["sensors"].startswith("a number")
    assert Setting("obstacles[].radius_m", "number", "m; of the cylinder") in settings(ScenarioConfig)


def test_page_is_written_without_torch():
    program = "import sys; import write_configuration as d; d.document(); print('torch' in sys.modules)"
    result = subprocess.run(
        [sys.executable, "-c", program], cwd=PATH.parent, capture_output=True, text=True, check=True
    )
    assert result.stdout == "False\n"
