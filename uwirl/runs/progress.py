"""Progress of learning: a bar on a terminal, a plain line every minute of vehicle time elsewhere."""

from __future__ import annotations

import logging
import sys

from uwirl.irl.policy_iteration import IterationRecord

log = logging.getLogger("uwirl")
WIDTH = 30


class Progress:
    """Args:
    total_s: vehicle time at which learning ends at the latest, s.
    shown: whether to show a bar at all.
    """

    def __init__(self, total_s: float, shown: bool):
        self.total_s = total_s
        # Without any stderr Python has None.
        self.bar = shown and sys.stderr is not None and sys.stderr.isatty()
        self.next_line_s = 60.0

    def update(self, record: IterationRecord) -> None:
        text = (
            f"iteration {record.iteration}, {record.seconds:.0f} s flown, weights change by {record.weight_change:.1e}"
        )
        if self.bar:
            filled = min(WIDTH, round(WIDTH * record.seconds / self.total_s))
            sys.stderr.write(f"\r  learning [{'#' * filled}{'.' * (WIDTH - filled)}] {text}\033[K")
            sys.stderr.flush()
        elif record.seconds >= self.next_line_s:
            log.info("  learning: %s", text)
            self.next_line_s = record.seconds + 60.0

    def close(self) -> None:
        if self.bar:
            sys.stderr.write("\r\033[K")
