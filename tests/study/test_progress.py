"""Bars: with the time left on a terminal, nothing elsewhere or where they are not wanted."""

from __future__ import annotations

import io
import logging

import pytest
from tqdm import tqdm

from uwirl.study.progress import bar


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def shown(monkeypatch: pytest.MonkeyPatch, stream: io.StringIO | None, wanted: bool = True) -> None:
    monkeypatch.setattr("sys.stderr", stream)
    monkeypatch.setenv("COLUMNS", "100")
    with bar("flying", 4, wanted) as progress:
        assert isinstance(progress, tqdm)
        for _ in range(4):
            progress.update()
        progress.refresh()
        logging.getLogger("uwirl").info("a line")
    assert not logging.getLogger("uwirl").filters


def test_on_a_terminal(monkeypatch):
    stream = Terminal()
    shown(monkeypatch, stream)
    texts = stream.getvalue().split("\r")
    assert any(text.startswith("  flying   0%|") and text.rstrip().endswith("left") for text in texts)
    assert any(text.startswith("  flying 100%|") for text in texts)
    # The line is left as if nothing had been there.
    assert texts[-2].strip() == ""


@pytest.mark.parametrize(("stream", "wanted"), [(io.StringIO(), True), (Terminal(), False), (None, True)])
def test_nowhere_else(monkeypatch, stream, wanted):
    shown(monkeypatch, stream, wanted)
    assert stream is None or stream.getvalue() == ""
