"""Algorithm 1's second loop as an app runs it: watched, saved every few legs, interruptible between two of them."""

from __future__ import annotations

import logging
from typing import Any

from uwirl.config.schema import Config, IrlConfig
from uwirl.irl.policy_iteration import IterationRecord
from uwirl.motion.planner import LearningPlanner
from uwirl.runs.interruption import Interruption
from uwirl.runs.progress import Progress
from uwirl.runs.saving import Checkpoints, Origin
from uwirl.snr.estimate import ChannelEstimate
from uwirl.study.tensorboard import TensorBoard
from uwirl.world.relay import Relay

log = logging.getLogger("uwirl")


def learn(
    config: Config,
    planner: LearningPlanner,
    env: Relay,
    estimate: ChannelEstimate,
    origin: Origin,
    checkpoints: Checkpoints,
    interruption: Interruption,
    board: TensorBoard,
) -> list[IterationRecord]:
    """Fit the planner; returns its records, those of before an interruption too.

    Raises:
        Interrupted: a signal came; the legs until then are saved.
    """
    assert isinstance(config.planner, IrlConfig)
    state, records = origin.learner()
    if state is not None:
        log.info("continues after iteration %d, %.0f s of flight", state.record.iteration, state.record.seconds)
    # A run that is continued in another folder tells there what came before.
    logged = len(records) if board.continues else 0
    progress = Progress(config.planner.max_time_s, config.logging.progress)
    # A leg that is cut short teaches nothing, and would not be flown again the same from where it was cut.
    with interruption.postponed():
        for record in planner.iterate(env, estimate, state):
            records.append(record)
            progress.update(record)
            for new in records[logged:]:
                board.iteration(new, planner.basis)
            logged = len(records)
            if record.closes:
                if interruption.number is not None or planner.state.flight.leg % checkpoints.every == 0:
                    checkpoints.last(planner, estimate, records)
                    board.flush()
                interruption.check()
        progress.close()
        checkpoints.last(planner, estimate, records)
    last = records[-1]
    log.info(
        "learned in %d policy iterations from %.0f s of flight%s",
        last.iteration,
        last.seconds,
        ", weights settled" if last.converged else "",
    )
    return records


def learning_metrics(config: Config, planner: LearningPlanner, records: list[IterationRecord]) -> dict[str, Any]:
    last = records[-1]
    return {
        "learning_vehicle_seconds": last.seconds,
        "learning_env_steps": round(last.seconds / config.scenario.dt_s),
        "learning_collisions": planner.recorder.contacts,
        "policy_iterations": last.iteration,
    }
