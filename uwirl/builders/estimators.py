"""Stage 1 from settings."""

from __future__ import annotations

from uwirl.builders.own import make_own
from uwirl.config.schema import EstimatorConfig, OwnEstimatorConfig
from uwirl.snr.estimators import ESTIMATORS, Estimator
from uwirl.snr.screening import screen


def make_estimator(config: EstimatorConfig) -> Estimator:
    estimator = _estimator(config)
    if config.robust:
        return lambda readings, known: estimator(screen(readings, known), known)
    return estimator


def _estimator(config: EstimatorConfig) -> Estimator:
    if isinstance(config, OwnEstimatorConfig):
        own: Estimator = make_own(config, "estimator")
        return own
    return ESTIMATORS[config.name]
