"""Commands in this process, and a run that they are held against."""

from __future__ import annotations

import logging
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from flights import SHORT, go


@pytest.fixture
def call(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., None]]:
    """call(main, "key=value", ...): an entry point with a command line; what Hydra did to logging is undone."""
    root = logging.getLogger()
    handlers, level = root.handlers[:], root.level

    def called(main: Callable[[], None], *arguments: str) -> None:
        monkeypatch.setattr(sys, "argv", ["uwirl", *arguments])
        main()

    yield called
    for handler in root.handlers:
        if handler not in handlers:
            handler.close()
    root.handlers[:] = handlers
    root.setLevel(level)


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> Path:
    """A run that was never interrupted."""
    folder = tmp_path_factory.mktemp("whole")
    go(folder, *SHORT)
    return folder
