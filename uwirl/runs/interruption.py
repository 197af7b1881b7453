"""SIGINT and SIGTERM: the leg in flight is finished and saved; a second signal kills at once."""

from __future__ import annotations

import re
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType

SIGNALS = (signal.SIGINT, signal.SIGTERM)
# Errors in metrics.json that begin so are no failures of the run.
INTERRUPTED = "interrupted by "


class Interrupted(BaseException):
    """A signal asked the run to end. No Exception, lest somebody's handler for errors swallows it.

    Args:
        number: of the signal.
    """

    def __init__(self, number: int):
        super().__init__(f"{INTERRUPTED}{signal.Signals(number).name}")
        self.exit_code = 128 + number

    def told(self, last: Path) -> str:
        """What to say of it, given where the run's last checkpoint would be."""
        if last.is_file():
            plain = re.fullmatch(r"[\w/.+-]*", str(last))
            return f"{self}; " + (f"resume={last}" if plain else f"\"resume='{last}'\"") + " continues"
        return f"{self} with nothing saved to continue from; start it again with the command that started it"


class Interruption:
    """Signals, while in its context: raised as Interrupted at once, or where `check` is called in `postponed`."""

    def __init__(self) -> None:
        self.number: int | None = None
        self._wait = False

    def __enter__(self) -> Interruption:
        # Python takes signals in its main thread only; elsewhere they are somebody else's.
        here = threading.current_thread() is threading.main_thread()
        self._before = {number: signal.signal(number, self._take) for number in SIGNALS} if here else {}
        return self

    def __exit__(self, *exception: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _take(self, number: int, frame: FrameType | None) -> None:
        for each in SIGNALS:
            signal.signal(each, signal.SIG_DFL)
        self.number = number
        if not self._wait:
            raise Interrupted(number)

    @contextmanager
    def postponed(self) -> Iterator[None]:
        """Signals wait for `check`, or for the end of this context."""
        self._wait = True
        try:
            yield
        finally:
            self._wait = False
        self.check()

    def check(self) -> None:
        """Raises Interrupted if a signal has come."""
        if self.number is not None:
            raise Interrupted(self.number)
