"""The learner is for any control-affine system: it has no word of what moves, where, or how experience came about."""

import re
from pathlib import Path

import pytest

import uwirl.irl

MODULES = sorted(Path(uwirl.irl.__file__).parent.glob("*.py"))
FOREIGN = re.compile(
    r"vehicle|flight|flown|\bfl(y|ies|ew)\b|relabel|\bmet(re|er)s?\b|\bwater|\bsea\b|ocean|acoustic|tau_trim|\w_m\b",
    re.IGNORECASE,
)


@pytest.mark.parametrize("module", MODULES, ids=lambda module: module.name)
def test_no_word_of_vehicles(module: Path):
    assert FOREIGN.findall(module.read_text(encoding="utf-8")) == []
    assert FOREIGN.search(module.stem) is None


@pytest.mark.parametrize(
    "text", ["a vehicle's", "Fly longer", "flown", "relabelled", "in metres", "tau_trim", "step_m"]
)
def test_such_words_are_seen(text: str):
    assert FOREIGN.search(text)
