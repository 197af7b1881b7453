"""Figures and animations of a run, where matplotlib is installed and `logging` asks for them."""

from __future__ import annotations

import importlib.util
import logging
from collections.abc import Sequence
from pathlib import Path

from torch import Tensor

from uwirl.config.schema import LoggingConfig
from uwirl.motion.features import MotionBasis
from uwirl.motion.learning import IterationRecord
from uwirl.snr.diagnostics import Diagnostics
from uwirl.snr.estimate import ChannelEstimate
from uwirl.study.evaluation import Evaluation
from uwirl.study.shadowing import LinksAtMessages
from uwirl.study.snr_map import SnrMap
from uwirl.world.readings import Readings
from uwirl.world.relay import Relay

log = logging.getLogger("uwirl")


def mission(
    logging_config: LoggingConfig,
    folder: Path,
    env: Relay,
    evaluation: Evaluation,
    messages: LinksAtMessages,
    records: Sequence[IterationRecord] = (),
    basis: MotionBasis | None = None,
) -> Path | None:
    """figures/mission.png, whose path is returned, and, with logging.animation, mission.gif."""
    if not _possible(logging_config):
        return None
    from uwirl.study import animation, figures

    path = folder / "figures" / "mission.png"
    figures.save(figures.mission_figure(env.scenario, evaluation, messages, records, basis), path)
    log.info("figure: %s", path)
    if logging_config.animation:
        animation.save(env.scenario, evaluation, path.with_suffix(".gif"))
        log.info("animation: %s", path.with_suffix(".gif"))
    return path


def layouts(logging_config: LoggingConfig, folder: Path, env: Relay, evaluation: Evaluation, kind: Tensor) -> None:
    """figures/layouts.png."""
    if not _possible(logging_config):
        return
    from uwirl.study import figures

    path = folder / "figures" / "layouts.png"
    figures.save(figures.layouts_figure(env, evaluation, kind), path)
    log.info("figure: %s", path)


def estimate(
    logging_config: LoggingConfig,
    folder: Path,
    readings: Readings,
    channel: ChannelEstimate,
    diagnostics: Diagnostics,
    snr_map: SnrMap,
    names: tuple[str, ...],
) -> None:
    """figures/estimate.png."""
    if not _possible(logging_config):
        return
    from uwirl.study import estimate_figure, figures

    path = folder / "figures" / "estimate.png"
    figures.save(estimate_figure.estimate_figure(readings, channel, diagnostics, snr_map, names), path)
    log.info("figure: %s", path)


def _possible(logging_config: LoggingConfig) -> bool:
    if not logging_config.figures:
        return False
    if importlib.util.find_spec("matplotlib") is None:
        log.info("no figure: matplotlib is not installed (pip install 'uwirl[plot]')")
        return False
    return True
