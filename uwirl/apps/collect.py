"""`uwirl-collect DIR`: the runs below a folder as one table, with figures."""

from __future__ import annotations

import argparse
import importlib.util
import io
import sys
from pathlib import Path

import uwirl
from uwirl.apps.terminal import BAD_CONFIGURATION, FAILED, tell


def main() -> None:
    """Entry point. Exits 2, with one message, where there are no runs; 1 if the results cannot be written."""
    parser = argparse.ArgumentParser(
        "uwirl-collect", description="Gather the runs below a folder, also while they run."
    )
    parser.add_argument("--version", action="version", version=f"uwirl {uwirl.__version__}")
    parser.add_argument("folder", type=Path, help="results.csv, results.md and figures/ are written here")
    folder: Path = parser.parse_args().folder
    if not folder.is_dir():
        print(f"uwirl-collect: {folder}: no such folder", file=sys.stderr)
        sys.exit(BAD_CONFIGURATION)
    # A terminal that lacks a sign shows another one.
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")
    sys.exit(_collect(folder))


def _collect(folder: Path) -> int:
    # Imported here so that a mistyped folder is answered before torch is loaded.
    from uwirl.study.atomic_io import write_whole
    from uwirl.study.collection import collect
    from uwirl.study.collection_report import csv_table, markdown

    found = collect(folder)
    if not found.jobs and not found.incomplete:
        skipped = "".join(f"; skipped {name}: {reason}" for name, reason in found.skipped[:3])
        print(f"uwirl-collect: {folder}: no runs below it{skipped}", file=sys.stderr)
        return BAD_CONFIGURATION
    report = markdown(found, folder.resolve().name)
    told, code = [report], 0
    try:
        for name, text in (("results.csv", csv_table(found)), ("results.md", report)):
            write_whole(folder / name, text.encode("utf-8", "backslashreplace"))
            told.append(f"written: {folder / name}")
        if importlib.util.find_spec("matplotlib") is None:
            told.append("no figures: matplotlib is not installed (pip install 'uwirl[plot]')")
        else:
            from uwirl.study.collection_figure import MOST_GROUPS, draw

            if len(found.groups()) > MOST_GROUPS:
                told.append(f"no figures: more than {MOST_GROUPS} groups cannot be told apart; collect a part of them")
            else:
                told += [f"figure: {path}" for path in draw(found, folder / "figures")]
    except OSError as error:
        print(f"uwirl-collect: {error.filename or folder}: cannot be written: {error.strerror}", file=sys.stderr)
        code = FAILED
    return tell("uwirl-collect", "\n".join(told)) or code


if __name__ == "__main__":
    main()
