"""Bars that tell how much is done and how much time is left; only on a terminal."""

from __future__ import annotations

import logging
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager

from tqdm import tqdm

log = logging.getLogger("uwirl")


@contextmanager
def bar(what: str, total: float, shown: bool = True) -> Iterator[tqdm]:
    """A bar on stderr until the context ends; nothing where stderr is no terminal.

    Args:
        what: is done meanwhile.
        total: sum of all that `update` will be called with.
        shown: False for no bar.

    Yields:
        The bar: `update(done)` after a part is done, `set_postfix_str(text)` to say more.
    """
    # Without any stderr Python has None.
    terminal = sys.stderr is not None and sys.stderr.isatty()
    # tqdm's own lock is a system semaphore, which a killed run would leave behind.
    tqdm.set_lock(threading.RLock())
    form = f"  {what} {{percentage:3.0f}}%|{{bar:30}}| {{remaining}} left{{postfix}}"
    with tqdm(total=total, disable=not (shown and terminal), leave=False, bar_format=form) as progress:

        def cleared(record: logging.LogRecord) -> bool:
            progress.clear()
            return True

        # A line of the log would be written behind the bar.
        log.addFilter(cleared)
        try:
            yield progress
        finally:
            log.removeFilter(cleared)
