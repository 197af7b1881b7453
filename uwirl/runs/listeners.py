"""Who listens to Algorithm 1 while it runs: the log, a bar, TensorBoard, checkpoints."""

from __future__ import annotations

import logging
import sys
import threading
from collections.abc import Callable

from tqdm import tqdm

from uwirl.algorithm import Estimated, Event, Improved, Planned
from uwirl.motion.learning import IterationRecord
from uwirl.runs.interruption import Interruption
from uwirl.runs.saving import Checkpoints
from uwirl.snr.estimate import ChannelEstimate
from uwirl.study.tensorboard import TensorBoard

log = logging.getLogger("uwirl")

Listener = Callable[[Event], None]


class Narrator:
    """What is estimated and learned, in the log; a bar on a terminal, elsewhere a line every minute of vehicle time.

    Args:
        total_s: vehicle time at which learning ends at the latest, s.
        bar: whether to show a bar at all.
    """

    def __init__(self, total_s: float, bar: bool):
        # Without any stderr Python has None.
        shown = bar and sys.stderr is not None and sys.stderr.isatty()
        # tqdm's own lock is a semaphore of the system, which a killed run would leave behind.
        tqdm.set_lock(threading.RLock())
        form = "  learning {percentage:3.0f}%|{bar:30}| {postfix}, {remaining} left"
        self.bar = tqdm(total=total_s, disable=not shown, leave=False, bar_format=form)
        self.next_line_s = 60.0

    def __call__(self, event: Event) -> None:
        """Tell of an event."""
        match event:
            case Estimated(_, estimate):
                for line in str(estimate).splitlines():
                    log.info("channel estimate: %s", line)
            case Improved(records=[*_, newest]):
                self._progress(newest)
            case Planned(_, learned):
                self.bar.close()
                if learned is not None:
                    state = learned[1]
                    settled = ", weights settled" if state.learner.settled else ""
                    iterations = state.learner.iteration
                    log.info(
                        "learned in %d policy iterations from %.0f s of flight%s", iterations, state.seconds, settled
                    )

    def _progress(self, record: IterationRecord) -> None:
        flown = f"{record.seconds:.0f} s flown"
        text = f"iteration {record.iteration}, {flown}, weights change by {record.weight_change:.1e}"
        if not self.bar.disable:
            self.bar.set_postfix_str(text, refresh=False)
            self.bar.update(min(record.seconds, self.bar.total) - self.bar.n)
        elif record.seconds >= self.next_line_s:
            log.info("  learning: %s", text)
            self.next_line_s = record.seconds + 60.0


class Board:
    """TensorBoard: the estimate, and weights at each iteration.

    Args:
        board: writes.
        before: records of a run that is continued, which it tells first in a folder that is new.
    """

    def __init__(self, board: TensorBoard, before: list[IterationRecord]):
        self.board = board
        self.untold = [] if board.continues else list(before)

    def __call__(self, event: Event) -> None:
        """Write an event."""
        match event:
            case Estimated(_, estimate):
                self.board.estimate(estimate)
            case Improved(learning, _, records):
                for record in [*self.untold, *records]:
                    self.board.iteration(record, learning.basis)
                self.untold = []


class Saver:
    """Keeps the records, and saves every few legs, at the end, and where a signal ends the run.

    Args:
        checkpoints: where to.
        interruption: tells of signals.
        board: is flushed with each checkpoint.
        before: records of a run that is continued.
    """

    def __init__(
        self, checkpoints: Checkpoints, interruption: Interruption, board: TensorBoard, before: list[IterationRecord]
    ):
        self.checkpoints, self.interruption, self.board = checkpoints, interruption, board
        self.records = before
        self.estimate: ChannelEstimate | None = None

    def __call__(self, event: Event) -> None:
        """Keep an event; raises Interrupted if a signal came, with all that was learned saved."""
        match event:
            case Estimated(_, estimate):
                self.estimate = estimate
            case Improved(learning, state, records):
                self.records += records
                interrupted = self.interruption.number is not None
                if self.records and (interrupted or state.flight.leg % self.checkpoints.every == 0):
                    assert self.estimate is not None
                    self.checkpoints.last(learning, state, self.estimate, self.records)
                    self.board.flush()
                self.interruption.check()
            case Planned(_, (learning, state)):
                assert self.estimate is not None
                self.checkpoints.last(learning, state, self.estimate, self.records)
