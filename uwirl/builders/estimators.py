"""Stage 1 from settings."""

from __future__ import annotations

from uwirl.config.schema import EstimatorConfig
from uwirl.snr.estimators import ESTIMATORS, Estimator
from uwirl.snr.screening import screen


def make_estimator(config: EstimatorConfig) -> Estimator:
    estimator = ESTIMATORS[config.name]
    if config.robust:
        return lambda readings, known: estimator(screen(readings, known), known)
    return estimator
