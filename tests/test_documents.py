"""The Python examples of README and docs run."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
EXAMPLES = [
    pytest.param(code, id=f"{document.name}-{number}")
    for document in [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
    for number, code in enumerate(re.findall(r"```python\n(.*?)```", document.read_text(), re.DOTALL))
]


@pytest.mark.parametrize("code", EXAMPLES)
def test_example_runs(code, capsys):
    exec(compile(code, "example", "exec"), {})
    assert "nan" not in capsys.readouterr().out


def test_links_lead_somewhere():
    documents = [*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md"), *(ROOT / "experiments").glob("*.md")]
    for document in documents:
        for target in re.findall(r"\]\(([^)#]+)\)", document.read_text()):
            if "://" not in target:
                assert (document.parent / target).exists(), f"{document.name} links to {target}"


def test_every_script_of_experiments_says_what_it_does():
    scripts = {path.stem for path in (ROOT / "experiments").glob("*.py") if "@hydra.main" in path.read_text()}
    assert scripts == {path.stem for path in (ROOT / "experiments" / "conf").glob("*.yaml")}
    for name in scripts:
        assert "override hydra/help: script" in (ROOT / "experiments" / "conf" / f"{name}.yaml").read_text()
    command = [sys.executable, ROOT / "experiments" / "known_answers.py", "--help"]
    told = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert told.startswith("The generic learner on problems whose answer is known")
    assert "random_systems: 100" in told
