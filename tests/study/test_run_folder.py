"""Whose a run folder is, and whether what it holds is what is wanted."""

import json

import pytest

from uwirl.study import run_folder


def write(folder, text: str):
    (folder / "metrics.json").write_text(text)


@pytest.mark.parametrize("group", ["experiment=fig6_pair", "experiment=random_layouts", "ablation=unbounded"])
def test_folder_is_claimed_by_one_configuration(make_config, tmp_path, group: str):
    mine, other = make_config(group), make_config(group, "seed=1")
    assert run_folder.claim(tmp_path, mine)
    # Claimed, but not yet known by whom.
    assert not run_folder.claim(tmp_path, mine)
    run_folder.write_config(tmp_path, mine)
    assert run_folder.claim(tmp_path, mine)
    assert run_folder.claim(tmp_path, make_config(group, "logging.figures=false"))
    assert not run_folder.claim(tmp_path, other)


@pytest.mark.parametrize("content", [b"", b"[1, 2]", b"a: [", b"\xff\xfe\x00", b"a: ${nowhere}", b"3"])
def test_damaged_configuration_is_anothers(make_config, tmp_path, content: bytes):
    (tmp_path / "config.yaml").write_bytes(content)
    assert not run_folder.claim(tmp_path, make_config())
    assert (tmp_path / "config.yaml").read_bytes() == content


def test_complete_means_this_configuration(make_config, tmp_path):
    config = make_config()
    wanted_hash = run_folder.config_hash(config)
    metrics = {"status": "complete", "config_hash": wanted_hash}
    assert not run_folder.is_complete(tmp_path, wanted_hash)
    for wanted, changed in [(True, {}), (False, {"status": "failed"}), (False, {"config_hash": "0"})]:
        write(tmp_path, json.dumps(metrics | changed))
        assert run_folder.is_complete(tmp_path, wanted_hash) is wanted
    write(tmp_path, json.dumps(metrics)[:-5])
    assert not run_folder.is_complete(tmp_path, wanted_hash)


@pytest.mark.parametrize("text", ["", "{", "[]", "{}", '{"status": "done"}', "\x00", "[" * 100_000])
def test_what_is_no_runs_metrics(tmp_path, text: str):
    write(tmp_path, text)
    with pytest.raises(ValueError, match=r"."):
        run_folder.read_metrics(tmp_path)


def test_clearing_leaves_what_is_not_a_runs(tmp_path):
    for name in ("metrics.json", "trajectory.npz", "run.log", "notes.txt"):
        (tmp_path / name).write_text("{}")
    (tmp_path / "tb").mkdir()
    (tmp_path / "tb" / "events").touch()
    run_folder.clear(tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["notes.txt", "run.log"]
    run_folder.clear(tmp_path)


def test_clearing_spares_folders_that_no_run_has_been_in(make_config, tmp_path):
    (tmp_path / "figures").mkdir()
    (tmp_path / "figures" / "own.png").touch()
    assert run_folder.claim(tmp_path, make_config())
    run_folder.clear(tmp_path)
    assert (tmp_path / "figures" / "own.png").exists()
