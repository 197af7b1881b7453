"""Statistics of a sweep, on folders made by hand."""

import csv
import io
import json
import os

import numpy as np
import pytest
from scipy import stats

from uwirl.study import collection_figure, run_files, style
from uwirl.study.collection import Collection, Interval, Job, collect, interval, rounded
from uwirl.study.collection_report import MOST_SKIPPED, csv_table, markdown


@pytest.fixture
def add(tmp_path):
    """add("planner=pd,seed=0", cost_total=...): a run's folder, complete unless told otherwise."""

    def run(name: str, **metrics):
        folder = tmp_path / name
        folder.mkdir(parents=True)
        (folder / "config.yaml").touch()
        (folder / "metrics.json").write_text(json.dumps({"status": "complete", "error": None} | metrics))

    return run


def learned(folder, costs):
    """iterations.csv of a run whose iterates took 10 s each."""
    lines = [f"{k},{10.0 * k},100,0.1,,,{'' if cost is None else cost},0" for k, cost in enumerate(costs, 1)]
    (folder / "iterations.csv").write_text("\n".join([",".join(run_files.ITERATION_COLUMNS), *lines, ""]))


def rows(found: Collection) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(csv_table(found))))


@pytest.mark.parametrize("n", [2, 3, 10, 40])
def test_interval_is_scipys(n: int):
    values = np.random.default_rng(n).normal(3.0, 0.5, n)
    found = interval(values.tolist())
    low, high = stats.t.interval(0.95, n - 1, values.mean(), stats.sem(values))
    assert found is not None
    assert found.n == n
    assert found.mean == pytest.approx(values.mean(), rel=1e-12)
    assert (found.mean - found.half, found.mean + found.half) == pytest.approx((low, high), rel=1e-8)


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ([2.5], "2.5"),
        ([1.0, 1.0, 1.0], "1 ± 0"),
        ([0.1, 0.1, 0.1, 0.1 + 1e-17], "0.1 ± 0"),
        ([62.0, 63.0], "62.5 ± 6.4"),
        ([3.295, 3.297, 3.294], "3.2953 ± 0.0038"),
        ([1000.0, 3000.0], "2000 ± 12706"),
    ],
)
def test_interval_is_written_to_two_digits(values: list[float], text: str):
    assert str(interval(values)) == text


def test_no_interval_of_nothing_and_wide_ranges():
    assert interval([]) is None
    assert str(Interval(1.0, 1e-9, 2)) == "1 ± 1e-09"
    assert str(Interval(1e9, 1e8, 2)) == "1e+09 ± 1e+08"


def test_groups_are_overrides_but_the_seed(add, tmp_path):
    cost = {("pd", 0): 3.0, ("pd", 1): 5.0, ("irl", 0): 2.0, ("irl", 1): 2.5}
    for (planner, seed), value in cost.items():
        add(f"channel=paper,planner={planner},seed={seed}", cost_total=value, seed=seed, config_hash=f"{planner}{seed}")
    found = collect(tmp_path)
    assert found.varied == ["planner"]
    assert found.shared == {"channel": "paper"}
    groups = {key: [job.number("cost_total") for job in group] for key, group in found.groups().items()}
    assert groups == {("irl",): [2.0, 2.5], ("pd",): [3.0, 5.0]}
    # half = t s / sqrt(n) = 12.706 * sqrt(2) / sqrt(2)
    cells = [line.split() for line in markdown(found, "x").splitlines() if line.startswith("| pd")]
    assert cells == [["|", "pd", "|", "2", "|", "4", "±", "13", "|"]]


def test_values_that_are_missing_are_told(add, tmp_path):
    for seed, t99 in enumerate([30.0, None, 34.0]):
        add(f"seed={seed}", time_to_99_percent_s=t99, cost_total=float("nan"), seed=seed)
    text = markdown(collect(tmp_path), "x")
    assert "32 ± 25 (2 of 3)" in text
    assert "cost_total" not in text


def test_a_repeated_configuration_counts_once(add, tmp_path):
    for name, seed in (("a", 0), ("b", 0), ("c", 1)):
        add(name, experiment="e", seed=seed, config_hash=f"h{seed}", cost_total=1.0 + seed)
    found = collect(tmp_path)
    assert [len(group) for group in found.groups().values()] == [2]
    assert "Left out of the means: 1 " in markdown(found, "x")
    assert len(rows(found)) == 3


def test_overrides_with_commas_are_told_apart(add, tmp_path):
    start = "scenario.start=[[1,2,-3,0],[4,5,-6,0]]"
    add(f"+a.b=1,{start},planner@baseline=pd,seed=3")
    add("shortened_0123", overrides=["+a.b=2", start, "x='u=v,w=1'"], experiment="e")
    named, listed = collect(tmp_path).jobs
    assert named.overrides == {"a.b": "1", "scenario.start": start[15:], "planner@baseline": "pd", "seed": "3"}
    assert listed.overrides == {"experiment": "e", "a.b": "2", "scenario.start": start[15:], "x": "'u=v,w=1'"}


def test_csv_has_a_row_a_job(add, tmp_path):
    add("planner=irl,seed=0", seed=0, cost_per_iteration=[2.0, 1.5], converged=True, cost_total=0.1 + 0.2)
    add("planner=pd", seed=7, status="failed", error='NoTargetError: "far", 50 % | x\nand more')
    learned, failed = rows(collect(tmp_path))
    assert list(learned)[:5] == ["job", "planner", "seed", "status", "error"]
    assert json.loads(learned["cost_per_iteration"]) == [2.0, 1.5]
    assert float(learned["cost_total"]) == 0.1 + 0.2
    assert learned["converged"] == "true"
    # The seed, known though it was no override.
    assert (failed["seed"], failed["status"], failed["cost_total"]) == ("7", "failed", "")
    assert failed["error"] == 'NoTargetError: "far", 50 % | x\nand more'


def test_what_is_no_complete_run_is_named(add, tmp_path):
    add("seed=0", cost_total=1.0)
    add("seed=1", status="failed", error="DivergedError: tau\nis not finite")
    for name, content in [("broken", "{"), ("list", "[1]"), ("foreign", '{"status": 3}'), ("binary", "\x00\udcff")]:
        (tmp_path / name).mkdir()
        (tmp_path / name / "metrics.json").write_bytes(content.encode("utf-8", "surrogateescape"))
    (tmp_path / "killed" / "tb").mkdir(parents=True)
    (tmp_path / "killed" / "run.log").touch()
    (tmp_path / "empty").mkdir()
    (tmp_path / "directory" / "metrics.json").mkdir(parents=True)
    (tmp_path / "notes.txt").touch()
    (tmp_path / "multirun.yaml").touch()
    found = collect(tmp_path)
    assert [job.name for job in found.jobs] == ["seed=0", "seed=1"]
    assert found.incomplete == ["killed"]
    assert {name for name, _ in found.skipped} == {
        *(f"{name}/metrics.json" for name in ("binary", "broken", "directory", "foreign", "list")),
        "empty",
        "notes.txt",
    }
    text = markdown(found, "x")
    assert "1 complete, 1 failed, 1 incomplete." in text
    assert "- seed=1: DivergedError: tau is not finite" in text
    assert "## Incomplete: still running, or killed\n\n- killed\n" in text
    assert "- empty: empty folder" in text


def test_only_some_of_many_foreign_files_are_listed(add, tmp_path):
    add("run")
    for k in range(MOST_SKIPPED + 5):
        (tmp_path / f"{k}.txt").touch()
    assert "- and 5 more" in markdown(collect(tmp_path), "x")


def test_names_that_are_no_utf8_can_be_written(add, tmp_path):
    add("caf\udce9")
    (job,) = collect(tmp_path).jobs
    assert job.name == "caf\\xe9"


def test_tables_survive_signs_of_markdown():
    jobs = [Job(k, {"x": k}, {"status": "complete", "cost_total": 1.0}) for k in ("a|b", "c")]
    lines = markdown(Collection(jobs, [], []), "x").splitlines()
    table = [line for line in lines if line.startswith("|")]
    assert "a\\|b" in table[2]
    assert len({len(line) for line in table}) == 1


def test_failed_jobs_that_overrides_do_not_tell_are_named_by_folder(add, tmp_path):
    for name in ("one", "two"):
        add(name, status="failed", error="E")
    text = markdown(collect(tmp_path), "x")
    assert "- one: E" in text
    assert "- two: E" in text


def test_figures_show_groups_and_curves(add, tmp_path):
    for seed in range(3):
        add(f"planner=irl,seed={seed}", cost_total=3.0 + seed, seed=seed)
        learned(tmp_path / f"planner=irl,seed={seed}", [4.0, None, 3.0 + seed])
        add(f"planner=pd,seed={seed}", cost_total=3.5, seed=seed)
    found = collect(tmp_path)
    written = collection_figure.draw(found, tmp_path / "figures")
    assert [path.name for path in written] == ["boxes.png", "learning_curves.png"]
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in written)
    groups = {key[0]: group for key, group in found.groups().items()}
    (axes,) = collection_figure.curves_figure(groups).axes
    (median,), (band,) = axes.lines, axes.collections
    np.testing.assert_array_equal(median.get_xydata(), [[10.0, 4.0], [30.0, 4.0]])
    assert band.get_datalim(axes.transData).intervaly.tolist() == [3.0, 5.0]
    boxes = collection_figure.boxes_figure(groups, ["cost_total"]).axes[0]
    assert [label.get_text() for label in boxes.get_yticklabels()] == ["irl", "pd"]


def test_boxes_of_what_differs_alone(add, tmp_path, monkeypatch):
    """Not of what is the same in all jobs, nor of true and false; one that some jobs lack counts by the others."""
    for seed, t99 in enumerate([30.0, None, 34.0]):
        told = {"collisions": 0, "converged": seed > 0, "reach_rate": None if seed else 1.0}
        add(f"seed={seed}", cost_total=3.0 + seed, time_to_99_percent_s=t99, seed=seed, **told)
    drawn = []
    monkeypatch.setattr(style, "save", lambda figure, path: drawn.append(figure))
    assert len(collection_figure.draw(collect(tmp_path), tmp_path / "figures")) == 1
    assert [axes.get_xlabel() for axes in drawn[0].axes] == ["cost_total", "time_to_99_percent_s"]


def test_no_boxes_where_all_jobs_are_the_same(add, tmp_path):
    for seed in range(2):
        add(f"seed={seed}", cost_total=3.0, seed=seed)
    assert collection_figure.draw(collect(tmp_path), tmp_path / "figures") == []


def test_nothing_to_draw(add, tmp_path):
    add("seed=0", status="failed", error="E")
    assert collection_figure.draw(collect(tmp_path), tmp_path / "figures") == []
    assert not (tmp_path / "figures").exists()


STRANGE = {
    "too large for a float": {"cost_total": 10**400},
    "too large for its square": {"cost_total": 1e308},
    "of other types": {"seed": [1], "config_hash": {"a": 1}, "overrides": {"a": 1}, "experiment": 3},
    "half a sign": {"error": "\ud800", "overrides": ["a=\udce9"], "experiment": "\ud800"},
    "a formula": {"overrides": ["a=$\\frac{$", "b=$"]},
}


@pytest.mark.parametrize("metrics", STRANGE.values(), ids=STRANGE.keys())
def test_strange_metrics_spoil_no_other_job(add, tmp_path, metrics):
    for seed in range(3):
        add(f"seed={seed}", cost_total=1.0 + seed, config_hash=str(seed))
        learned(tmp_path / f"seed={seed}", [2.0, 1.0])
    add("strange", **metrics)
    found = collect(tmp_path)
    assert [job.name for job in found.jobs] == ["seed=0", "seed=1", "seed=2", "strange"]
    for text in (markdown(found, "x"), csv_table(found)):
        text.encode("utf-8", "backslashreplace")
    assert "2.0 ± 2.5" in markdown(found, "x")
    assert len(collection_figure.draw(found, tmp_path / "figures")) == 2


def test_pipes_and_endless_files_are_skipped(add, tmp_path):
    add("seed=0")
    for name in ("pipe", "endless"):
        (tmp_path / name).mkdir()
    os.mkfifo(tmp_path / "pipe" / "metrics.json")
    with (tmp_path / "endless" / "metrics.json").open("wb") as file:
        file.truncate(2**40)
    found = collect(tmp_path)
    assert [job.name for job in found.jobs] == ["seed=0"]
    reasons = [("endless/metrics.json", "File too large"), ("pipe/metrics.json", "Not a regular file")]
    assert sorted(found.skipped) == reasons


@pytest.mark.parametrize(
    "text", ["", "a,b\n1,2\n", f"{','.join(run_files.ITERATION_COLUMNS)}\n1,x,1,1,1,1,1,1\n", "\x00"]
)
def test_iterations_that_no_run_wrote_are_said_and_spoil_nothing(add, tmp_path, text):
    add("seed=0", cost_total=1.0)
    (tmp_path / "seed=0" / "iterations.csv").write_text(text)
    found = collect(tmp_path)
    assert [(job.name, job.learned) for job in found.jobs] == [("seed=0", [])]
    assert [name for name, _ in found.skipped] == ["seed=0/iterations.csv"]


@pytest.mark.parametrize("present", [b"before", None])
def test_a_figure_that_cannot_be_written_leaves_the_one_before(add, tmp_path, monkeypatch, present):
    def full_disk(handle):
        raise OSError(28, "No space left on device")

    for seed in range(2):
        add(f"seed={seed}", cost_total=1.0 + seed, seed=seed)
    path = tmp_path / "figures" / "boxes.png"
    path.parent.mkdir()
    if present:
        path.write_bytes(present)
    monkeypatch.setattr(os, "fsync", full_disk)
    with pytest.raises(OSError, match=r"No space left on device: '.*boxes\.png'$"):
        collection_figure.draw(collect(tmp_path), path.parent)
    assert [file.read_bytes() for file in path.parent.iterdir()] == ([present] if present else [])


@pytest.mark.parametrize(
    ("value", "told"),
    [
        ("2.2898514604770375", "2.29"),
        ("0.0005627932047415167", "0.0005628"),
        ("0.5", "0.5"),
        ("12345678", "12345678"),
        ("pd", "pd"),
        ("[2.0,.inf]", "[2.0,.inf]"),
        ("v1.2.34567", "v1.2.34567"),
    ],
)
def test_numbers_of_many_decimals_are_told_to_four_digits(value, told):
    assert rounded(value) == told


@pytest.mark.parametrize(
    ("other", "rows"), [("0.7000001", ["a.b=0.7", "a.b=0.7000001"]), ("0.71", ["a.b=0.7", "a.b=0.71"])]
)
def test_groups_that_differ_little_stay_apart(add, tmp_path, monkeypatch, other, rows):
    for value, cost in (("0.7", 1.0), (other, 2.0)):
        add(f"a.b={value}", cost_total=cost)
    drawn = []
    monkeypatch.setattr(style, "save", lambda figure, path: drawn.append(figure))
    collection_figure.draw(collect(tmp_path), tmp_path)
    assert [label.get_text() for label in drawn[0].axes[0].get_yticklabels()] == rows
