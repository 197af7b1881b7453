"""Stage 1 from settings."""

from __future__ import annotations

from uwirl.builders.own import make_own
from uwirl.config.schema import EstimatorConfig, OwnEstimatorConfig
from uwirl.snr.estimators import ESTIMATORS, Estimator, Oracle
from uwirl.snr.outliers import reject_outliers
from uwirl.world.relay import Relay
from uwirl.world.truth import truth_of


def make_estimator(config: EstimatorConfig, env: Relay | None = None) -> Estimator:
    """Of a name or a class; `oracle` is told the truth of an environment."""
    if config.name == "oracle" and env is not None:
        return Oracle(truth_of(env).channel)
    estimator = _estimator(config)
    if config.robust:
        return lambda readings, budget: estimator(reject_outliers(readings, budget), budget)
    return estimator


def _estimator(config: EstimatorConfig) -> Estimator:
    if isinstance(config, OwnEstimatorConfig):
        own: Estimator = make_own(config, "estimator")
        return own
    return ESTIMATORS[config.name]
