"""Listeners to the events of Algorithm 1: log, progress bar and TensorBoard; checkpoints are in `uwirl.runs.saving`."""

from __future__ import annotations

import logging
from collections.abc import Callable

from tqdm import tqdm

from uwirl.algorithm import Estimated, Event, Improved, Modelled, Planned
from uwirl.motion.identification import Identified
from uwirl.motion.identified_planner import Learned
from uwirl.motion.learning import IterationRecord
from uwirl.study.tensorboard import TensorBoard
from uwirl.world.trajectory import Trajectory

log = logging.getLogger("uwirl")

Listener = Callable[[Event], None]


class Narrator:
    """Logs estimate and learning: with a bar that is shown, else by a line every minute of vehicle time.

    Args:
        bar: its total is the vehicle time at which learning ends at the latest, s.
    """

    def __init__(self, bar: tqdm):
        self.bar = bar
        self.next_line_s = 60.0

    def __call__(self, event: Event) -> None:
        """Log an event."""
        match event:
            case Estimated(_, estimate):
                for line in str(estimate).splitlines():
                    log.info("channel estimate: %s", line)
            case Improved(records=[*_, newest]):
                self._progress(newest)
            case Modelled(names, learned) if learned.identified is not None:
                self._model(names, learned)
            case Planned(_, learned):
                if learned is not None:
                    state = learned[1]
                    if state.known is not None:
                        log.info("model: %s", _told(learned[0].planner.regressor.names, state.known))
                    settled = ", weights settled" if state.learner.settled else ""
                    iterations = state.learner.iteration
                    log.info(
                        "learned in %d policy iterations from %.0f s of flight%s", iterations, state.seconds, settled
                    )

    def _model(self, names: tuple[str, ...], learned: Learned) -> None:
        assert learned.identified is not None
        if learned.seconds >= self.next_line_s or not self.bar.disable:
            log.info("  learning: %.0f s flown, %s", learned.seconds, _told(names, learned.identified))
            self.next_line_s = learned.seconds + 60.0

    def _progress(self, record: IterationRecord) -> None:
        flown = f"{record.seconds:.0f} s flown"
        text = f"iteration {record.iteration}, {flown}, weights change by {record.weight_change:.1e}"
        if not self.bar.disable:
            self.bar.set_postfix_str(text, refresh=False)
            self.bar.update(min(record.seconds, self.bar.total) - self.bar.n)
        elif record.seconds >= self.next_line_s:
            log.info("  learning: %s", text)
            self.next_line_s = record.seconds + 60.0


def _told(names: tuple[str, ...], known: Identified) -> str:
    return ", ".join(f"{name} {value:.3g} +- {std:.1g}" for name, value, std in known.items(names))


class Legs:
    """Keeps what was flown while learning, if that was a mission.

    Attributes:
        flown: legs of the first mission, which begins at step 0; none of other flights.
    """

    def __init__(self) -> None:
        self.flown: list[Trajectory] = []

    def __call__(self, event: Event) -> None:
        """Keep a leg."""
        leg = None
        match event:
            case Improved(learning=learning, flown=flown) if not learning.planner.experience.hovers:
                leg = flown
            case Modelled(learned=Learned(in_mission=True, flown=flown)):
                leg = flown
        follows = self.flown[-1].first_step + len(self.flown[-1].tau) if self.flown else 0
        if leg is not None and leg.first_step == follows:
            self.flown.append(leg)


class Board:
    """Writes the estimate and the weights of each iteration to TensorBoard.

    Args:
        board: the writer.
        before: records of a continued run; written first if the folder is new.
        every: number of legs between checkpoints; the board is flushed with each, so that a killed run lacks nothing.
    """

    def __init__(self, board: TensorBoard, before: list[IterationRecord], every: int):
        self.board, self.every = board, every
        self.untold = [] if board.continues else list(before)
        self.known: Identified | None = None

    def __call__(self, event: Event) -> None:
        """Write an event."""
        match event:
            case Estimated(_, estimate):
                self.board.estimate(estimate)
            case Improved(learning, state, records):
                for record in [*self.untold, *records]:
                    self.board.iteration(record, learning.basis)
                self.untold = []
                if state.known is not self.known:
                    self.known = state.known
                    self.board.model(learning.planner.regressor.names, state.known, state.seconds)
                if state.flight.leg % self.every == 0:
                    self.board.flush()
            case Modelled(names, learned):
                self.board.model(names, learned.identified, learned.seconds)
