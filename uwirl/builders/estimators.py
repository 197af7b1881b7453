"""Stage 1 from settings."""

from __future__ import annotations

from uwirl.config.make import make
from uwirl.config.schema import OURS, EstimatorConfig
from uwirl.snr.estimators import ESTIMATORS, Estimator
from uwirl.snr.screening import screen


def make_estimator(config: EstimatorConfig) -> Estimator:
    estimator = _estimator(config)
    if config.robust:
        return lambda readings, known: estimator(screen(readings, known), known)
    return estimator


def _estimator(config: EstimatorConfig) -> Estimator:
    if config.target != OURS + config.name:
        own: Estimator = make(config)
        return own
    return ESTIMATORS[config.name]
