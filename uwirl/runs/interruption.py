"""SIGINT and SIGTERM: the present leg is finished and saved; a second signal kills at once."""

from __future__ import annotations

import shlex
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType

SIGNALS = (signal.SIGINT, signal.SIGTERM)


class Interrupted(BaseException):
    """A signal ended the run. Not an Exception, so that handlers of errors do not catch it.

    Args:
        number: number of the signal.
    """

    def __init__(self, number: int):
        super().__init__(f"interrupted by {signal.Signals(number).name}")
        self.exit_code = 128 + number

    def told(self, last: Path) -> str:
        """The message for the user, given the path at which a checkpoint may exist."""
        if last.is_file():
            return f"{self}; {shlex.quote(f'resume={last}')} continues"
        return f"{self} with nothing saved to continue from; start it again with the command that started it"


class Interruption:
    """Context that raises signals as Interrupted: at once, or within `postponed` when `check` is called."""

    def __init__(self) -> None:
        self.number: int | None = None
        self._wait = False

    def __enter__(self) -> Interruption:
        # Python handles signals in the main thread only.
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
        """Context in which signals are raised by `check`, or at its end."""
        self._wait = True
        try:
            yield
        finally:
            self._wait = False
        self.check()

    def check(self) -> None:
        """Raise the signal that was received, if any.

        Raises:
            Interrupted: a signal was received.
        """
        if self.number is not None:
            raise Interrupted(self.number)
