"""The floors of the house: imports only go down, and nothing below the apps knows Hydra."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

import uwirl

ROOT = Path(uwirl.__file__).parent
MODULES = sorted(path.relative_to(ROOT.parent) for path in ROOT.rglob("*.py"))
# irl and world share a floor, so neither may import the other.
FLOORS = {
    "config": 0,
    "irl": 1,
    "world": 1,
    "snr": 2,
    "motion": 3,
    "envs": 4,
    "study": 5,
    "builders": 6,
    "build": 7,
    "runs": 8,
    "apps": 9,
}


def imports(source: str, package: tuple[str, ...]) -> set[str]:
    """Dotted names that a module of `package` imports, wherever in its body; `from a import b` gives a.b."""
    found = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        if isinstance(node, ast.ImportFrom):
            parent = list(package[: len(package) + 1 - node.level]) if node.level else []
            parent += [node.module] if node.module else []
            found |= {".".join([*parent, alias.name]) for alias in node.names}
    return found


def imports_of(module: Path) -> set[str]:
    return imports((ROOT.parent / module).read_text(encoding="utf-8"), module.parent.parts)


def member(dotted: str) -> str | None:
    """The package or module directly under uwirl that a dotted name lies in, if it lies in one."""
    parts = dotted.split(".")
    known = (ROOT / parts[1]).is_dir() or (ROOT / f"{parts[1]}.py").is_file() if len(parts) > 1 else False
    return parts[1] if parts[0] == "uwirl" and known else None


def home(module: Path) -> str:
    return module.with_suffix("").parts[1]


def test_every_module_has_a_floor():
    assert {home(module) for module in MODULES} - {"__init__"} <= FLOORS.keys()


@pytest.mark.parametrize("module", MODULES, ids=str)
def test_imports_go_down(module: Path):
    own = home(module)
    floor = FLOORS.get(own, -1)  # uwirl/__init__.py lies under everything
    imported = {name for name in map(member, imports_of(module)) if name is not None}
    assert {name for name in imported - {own} if FLOORS[name] >= floor} == set()


@pytest.mark.parametrize("module", [m for m in MODULES if home(m) not in ("apps", "config")], ids=str)
def test_hydra_stays_above(module: Path):
    assert "hydra" not in {name.split(".")[0] for name in imports_of(module)}


@pytest.mark.parametrize(
    ("source", "found"),
    [
        ("import uwirl.apps.run as r", "apps"),
        ("from uwirl import build", "build"),
        ("from ..irl.rls import RecursiveLeastSquares", "irl"),
        ("from .. import snr", "snr"),
        ("def f():\n    from uwirl.study.checkpoint import save", "study"),
    ],
)
def test_every_form_of_import_is_seen(source: str, found: str):
    assert {member(name) for name in imports(source, ("uwirl", "world"))} == {found}
