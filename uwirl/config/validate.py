"""Rules that a composed configuration must obey. Knows no torch: it answers before anything heavy is imported."""

from __future__ import annotations

from uwirl.config.checks import ConfigError, named, one_of
from uwirl.config.own import check_own
from uwirl.config.planning_rules import check_cost, check_guidance, check_planner, check_safety, check_solver
from uwirl.config.schema import (
    Config,
    EstimatorConfig,
    GeodesicConfig,
    IrlConfig,
    LinkFrameBasisConfig,
    OwnBasisConfig,
    OwnEstimatorConfig,
    VirtualLinksConfig,
)
from uwirl.config.world_rules import (
    check_channel,
    check_current,
    check_detection,
    check_layouts,
    check_obstacles,
    check_scenario,
    check_vehicle,
)

# Those of uwirl.snr.estimators, which needs torch; a test compares them.
ESTIMATORS = ("least_squares", "generalized_least_squares", "separate", "maximum_likelihood", "disk", "oracle")
LINK_FRAME, ERROR = ("link_frame", "geodesic"), ("error_quadratic", "error_velocity")

__all__ = ["ConfigError", "validate"]


def validate(config: Config) -> None:
    """Check ranges and cross-field rules.

    Raises:
        ConfigError: the first rule that is broken.
    """
    check_scenario(config.scenario)
    check_channel(config.channel)
    check_vehicle(config.vehicle, config.scenario.dt_s)
    check_layouts(config.scenario)
    check_current(config.scenario, config.vehicle)
    check_estimator(config.estimator)
    check_basis(config)
    check_cost(config.cost)
    check_safety(config.safety, config)
    check_obstacles(config.scenario, config.safety)
    check_detection(config.scenario, config.vehicle, config.safety)
    check_guidance(config.guidance, config.scenario)
    check_solver(config.solver)
    check_planner(config.planner, "planner", config)
    check_planner(config.baseline, "baseline", config)
    check_start(config)
    if config.threads < 1:
        raise ConfigError("threads", f"must be at least 1, got {config.threads}")
    if not 0 <= config.seed < 2**63:
        raise ConfigError("seed", f"must lie in [0, 2^63), got {config.seed}")
    one_of(config.device.split(":")[0], "device", ("cpu", "cuda", "mps"))
    one_of(config.dtype, "dtype", ("float64", "float32"))
    # Last, because it imports what it checks.
    check_own(config)


def check_estimator(estimator: EstimatorConfig) -> None:
    if not isinstance(estimator, OwnEstimatorConfig):
        one_of(estimator.name, "estimator.name", ESTIMATORS)


def check_basis(config: Config) -> None:
    basis = config.basis
    if isinstance(basis, OwnBasisConfig):
        return
    here = LINK_FRAME if isinstance(basis, LinkFrameBasisConfig) else ERROR
    named(basis.name, "basis.name", (*LINK_FRAME, *ERROR), here)
    if isinstance(basis, LinkFrameBasisConfig):
        scales = basis.length_scales_m
        if not scales or any(not L > 0.0 for L in scales) or len(set(scales)) < len(scales):
            raise ConfigError("basis.length_scales_m", f"needs one or more different positive lengths, got {scales}")
    if basis.name == "geodesic" and isinstance(config.planner, IrlConfig):
        if not isinstance(config.guidance, GeodesicConfig):
            raise ConfigError("guidance.name", "basis=geodesic learns how to fly with guidance=geodesic")
        if isinstance(config.experience, VirtualLinksConfig) and config.experience.relabel:
            raise ConfigError("experience.relabel", "must be 0 with basis=geodesic: another link needs another map")


def check_start(config: Config) -> None:
    """Where a run starts from, and how often it is saved."""
    if config.checkpoint.every < 1:
        raise ConfigError("checkpoint.every", f"must be at least 1, got {config.checkpoint.every}")
    for key in ("resume", "init_from"):
        if getattr(config, key) == "":
            raise ConfigError(key, "names no checkpoint; give a file or a run folder")
    parts = config.init_from_parts
    for part in parts:
        one_of(part, "init_from_parts", ("estimate", "weights"))
    if not parts or len(set(parts)) < len(parts):
        raise ConfigError("init_from_parts", f"needs one or both of estimate, weights, got {parts}")
    if config.init_from is not None and "weights" in parts and not isinstance(config.planner, IrlConfig):
        raise ConfigError("init_from_parts", f"planner={config.planner.name} has no weights; choose [estimate]")
