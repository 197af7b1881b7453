"""The console entries before Hydra takes over: help, and one message with exit code 2 that leaves nothing behind."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

import uwirl
from uwirl.apps import collect, estimate, evaluate, run
from uwirl.apps.flags import read_flags
from uwirl.apps.program import note_failure
from uwirl.config.checks import ConfigError
from uwirl.config.compose import compose, searching
from uwirl.config.estimate_schema import register
from uwirl.config.groups import Groups, parsed, with_path
from uwirl.config.help import help_text
from uwirl.config.overrides import PATHS
from uwirl.config.sweeps import samples
from uwirl.config.validate import validate

PROGRAMS = {"uwirl": "config", "uwirl-estimate": "estimate"}


def command(folder: Path, *words: str, module: str = "run") -> subprocess.CompletedProcess[str]:
    words = (sys.executable, "-m", f"uwirl.apps.{module}", *words)
    return subprocess.run(words, cwd=folder, capture_output=True, text=True, check=False)


@pytest.fixture
def refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    """refused("key=value", ...): what `uwirl` says, in one line, before it exits with 2."""
    monkeypatch.chdir(tmp_path)

    def told(*words: str) -> str:
        monkeypatch.setattr(sys, "argv", ["uwirl", *words])
        with pytest.raises(SystemExit) as ended:
            run.main()
        out, err = capsys.readouterr()
        assert (ended.value.code, out, err.count("\n")) == (2, "", 1)
        return err

    return told


@pytest.fixture(autouse=True)
def _no_accelerator(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("torch.cuda.is_available", lambda: False)
    monkeypatch.setattr("torch.backends.mps.is_available", lambda: False)


def test_the_command_says_the_same(tmp_path: Path, refused):
    """In a process of its own."""
    result = command(tmp_path, "channel.zeta=3")
    assert (result.returncode, result.stdout, result.stderr) == (2, "", refused("channel.zeta=3"))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        ("cost.R=[0.1,0.1,-1,0.1]", "cost.R: must be positive definite"),  # breaks a rule
        ("scenario.duration=80", "scenario.duration: no such key; did you mean 'scenario.duration_s'?"),
        ("+channel.zeta=3", "channel.zeta: no such key; did you mean 'channel.zeta_dB'?"),
        ("channel=papr", "channel: 'papr' is none of"),
        ("scenario.dt_s=soon", "scenario.dt_s: must be a number, got soon"),
        ("ablation=no_map guidance=geodesic", "guidance: 'geodesic' undoes ablation=no_map"),
        ("scenario.start=[[1,2", "scenario.start: '[[1,2' cannot be read"),
        # A typo is every job's.
        ("--multirun seed=1,2 channel.zeta=3", "channel.zeta: no such key"),
        ("seed=1,x hydra.mode=MULTIRUN", "seed: must be a whole number, got x"),
        ("--multirun channel=paper,papr", "channel: 'papr' is none of"),
        ("--config-dir . channel.zeta=3", "channel.zeta: no such key"),
        ("--config-dir nowhere", "--config-dir: "),
        ("--cfg job sed=3", "sed: no such key; did you mean 'seed'?"),
        ("--mutirun seed=1,2", "--mutirun: no such flag; did you mean '--multirun'"),
        ("-m seed=range(0,0)", "seed: range(0,0) is empty, so that nothing would run"),
        ("device=cuda", "device: cuda is not there (no CUDA device that this PyTorch can use); choose device=cpu"),
        ("device=cuda:7 planner=pd", "device: cuda:7 is not there"),
        ("device=mps dtype=float32", "device: mps is not there (no MPS device that this PyTorch can use)"),
        ("device=mps", "dtype: device=mps knows no float64; add dtype=float32, or choose device=cpu"),
        ("device=cuda:x", "device: 'cuda:x' is none of cpu, cuda, cuda:N, mps"),
    ],
)
def test_one_message_and_nothing_left(tmp_path: Path, refused, overrides: str, message: str):
    assert refused(*overrides.split()).startswith(f"uwirl: {message}")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("planner.updatse: range(1, 3)", "planner.updatse: no such key; did you mean 'planner.updates'? ("),
        ("planner.updates: interval(1, 3)", "planner.updates: must be a whole number, got 1.0"),
        ("chanel: paper", "chanel: no such key; did you mean 'channel'?"),
    ],
)
def test_a_typo_in_a_search_space_is_one_too(tmp_path: Path, refused, line: str, message: str):
    path = tmp_path / "mine" / "hydra" / "sweeper" / "mine.yaml"
    path.parent.mkdir(parents=True)
    # Hydra's own sweeper has spaces, too.
    path.write_text(f"defaults: [basic]\nparams:\n  {line}\n")
    assert refused("-m", "--config-dir", "mine", "hydra/sweeper=mine").startswith(f"uwirl: {message}")
    assert list(tmp_path.iterdir()) == [tmp_path / "mine"]


def test_a_broken_rule_can_be_looked_at(tmp_path: Path):
    result = command(tmp_path, "--cfg", "job", "channel.n=-1")
    assert (result.returncode, result.stderr) == (0, "")
    assert "'n': -1.0" in result.stdout
    assert list(tmp_path.iterdir()) == []


def test_multirun_of_a_bad_log_leaves_metrics(tmp_path: Path):
    result = command(tmp_path, "-m", "max_readings=100,200", "data=log.csv", module="estimate")
    assert result.returncode == 1
    written = [json.loads(path.read_text()) for path in tmp_path.rglob("metrics.json")]
    assert [job["status"] for job in written] == ["failed", "failed"]
    assert all(job["error"].startswith("ConfigError: data: log.csv does not exist") for job in written)


@pytest.mark.parametrize("program", [run, estimate, evaluate, collect])
def test_version(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], program):
    monkeypatch.setattr(sys, "argv", ["uwirl", "--version"])
    with pytest.raises(SystemExit) as ended:
        program.main()
    assert (ended.value.code, capsys.readouterr().out) == (0, f"uwirl {uwirl.__version__}\n")


@pytest.mark.parametrize(
    ("program", "key"), [(run.Run(), "resume"), (estimate.Estimate(), "data"), (evaluate.Evaluate(), "checkpoint")]
)
def test_a_path_alone_is_told_its_key(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, program, key: str):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "seed=1").mkdir()
    for path in ("readings.csv", "seed=1"):
        with pytest.raises(ConfigError, match=f"^{path}: is no setting; did you mean '{key}={path}'"):
            program.checked([path])


def test_cuda_that_is_there_is_counted(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("torch.cuda.is_available", lambda: True)
    monkeypatch.setattr("torch.cuda.device_count", lambda: 1)
    validate(compose(["device=cuda:0"]))
    with pytest.raises(ConfigError, match="device: cuda:1 is not there, of 1 from cuda:0; choose one, or device=cpu"):
        validate(compose(["device=cuda:1"]))


NAMES = [
    "März.csv",
    "log (2).csv",
    "it's.csv",
    "~x",
    "a\\b",
    "a\\'b",
    "end\\",
    "a b",
    "a,b=c",
    "x#;&!^`<>.csv",
    "1e3",
    "null",
]


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("key", PATHS)
def test_any_file_name_is_read_as_it_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, key: str):
    monkeypatch.chdir(tmp_path)
    (tmp_path / name).touch()
    word = with_path(f"{key}={name}")
    assert parsed(word).value() == name
    assert with_path(word) == word


def test_paths_of_ones_home_and_of_a_sweep(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("HOME", "/home/me")
    assert parsed(with_path("data=~/log.csv")).value() == "/home/me/log.csv"
    assert parsed(with_path("data='~/a (b).csv'")).value() == "/home/me/a (b).csv"
    assert list(parsed(with_path("data=~/a.csv,März.csv")).sweep_string_iterator()) == [
        "'/home/me/a.csv'",
        "'März.csv'",
    ]
    for word in ("data=a.csv,b.csv", "data=null", "data=log.csv", "seed=1", "init_from=${resume}", "data='a b'"):
        assert with_path(word) == word


@pytest.mark.parametrize(("program", "name"), PROGRAMS.items())
def test_help_lists_options_and_no_schema(program: str, name: str):
    register()
    with searching() as loader:
        text = help_text(program, Groups(loader, name))
    assert "channel " in text
    assert "acoustic_24khz" in text
    assert "schema" not in text
    assert max(map(len, text.splitlines())) <= 120


@pytest.mark.parametrize("module", ["run", "estimate"])
def test_answers_load_nothing_heavy(tmp_path: Path, module: str):
    program = (
        "import sys\n"
        f"from uwirl.apps.{module} import main\n"
        "for words in ['--help'], ['channel.zeta=3'], ['channel=papr']:\n"
        "    sys.argv = ['uwirl', *words]\n"
        "    try: main()\n"
        "    except SystemExit as ended: print(ended.code)\n"
        "    print([name for name in ('torch', 'numpy', 'matplotlib') if name in sys.modules])\n"
    )
    result = subprocess.run([sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert result.stdout.splitlines()[-6:] == ["0", "[]", "2", "[]", "2", "[]"]
    assert list(tmp_path.iterdir()) == []


def test_help_knows_the_users_own_options(tmp_path: Path):
    (tmp_path / "channel").mkdir()
    (tmp_path / "channel" / "lake.yaml").write_text("defaults: [paper]\n")
    with searching(str(tmp_path)) as loader:
        assert "acoustic_24khz, lake, *paper" in help_text("uwirl", Groups(loader, "config"))


def test_flags():
    flags = read_flags(["-m", "seed=1,2", "channel=paper"])
    assert (flags.multirun, flags.overrides) == (True, ["seed=1,2", "channel=paper"])
    with pytest.raises(ConfigError, match="seed=2: stands behind a flag"):
        read_flags(["seed=1", "-m", "seed=2"])
    with pytest.raises(ConfigError, match="expected one argument"):
        read_flags(["--config-dir"])


def test_samples_are_the_jobs_that_differ_in_kind():
    words = ["seed=1,2,x", "channel=paper,acoustic_24khz", "channel.n=range(1,900)", "threads=1"]
    register()
    with searching() as loader:
        jobs = list(samples(words, loader))
        assert jobs == [
            ["seed=1", "channel=paper", "channel.n=1", "threads=1"],
            ["seed=x", "channel=paper", "channel.n=1", "threads=1"],
            ["seed=1", "channel=acoustic_24khz", "channel.n=1", "threads=1"],
        ]
        assert list(samples(["channel.n=interval(1,5)"], loader)) == [["channel.n=1.0"], ["channel.n=5.0"]]
        assert len(list(samples(["channel=glob(*)"], loader))) >= 2


def test_a_failure_is_noted_where_the_folder_is(tmp_path):
    note = note_failure(tmp_path)
    assert note is not None
    assert list(tmp_path.iterdir()) == [note]
    # On another machine of a cluster it is not.
    assert note_failure(tmp_path / "elsewhere") is None
