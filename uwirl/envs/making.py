"""Create the task from a configuration, given as on the command line."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from gymnasium.spaces import Box

from uwirl import build
from uwirl.config.compose import compose
from uwirl.config.validate import ConfigError, validate
from uwirl.envs.features import LIMIT
from uwirl.envs.task import RelayTask
from uwirl.study.evaluation import Evaluator
from uwirl.world.agent import Guard

# The paper's mission without its shadowing of 0.07 dB: two shadowed readings take as long as 80 steps of a vehicle.
NO_SHADOWING = ("channel.zeta_dB=0",)
RENDER_MODES = ["rgb_array"]


def make_task(overrides: Sequence[str] = NO_SHADOWING, guard: str | Guard | None = None, **options: Any) -> RelayTask:
    """The task of a configuration.

    Args:
        overrides: overrides as on uwirl's command line, `channel=acoustic_24khz`, `experiment=fig6_pair`.
        guard: guard between actions and thrusters: an option of the group `safety`, a custom guard, or None.
        options: options of `RelayTask`.

    Raises:
        ConfigError: the configuration breaks a rule, or has random layouts.
    """
    safety = "none" if guard is None else guard
    config = compose([*overrides, f"safety={safety}"] if isinstance(safety, str) else overrides)
    validate(config)
    if config.scenario.layouts is not None:
        raise ConfigError("scenario.layouts", "is of uwirl's own campaigns; random_start=True varies the start")
    env = build.make_relay(config)
    barrier = build.make_guard(config, env) if isinstance(safety, str) else safety
    return RelayTask(Evaluator(env, build.make_cost(config.cost), barrier), **options)


def chosen_task(task: RelayTask | None, options: dict[str, Any]) -> RelayTask:
    """The given task, or one made from the options.

    Raises:
        TypeError: both a task and options are given.
    """
    if task is not None and options:
        raise TypeError(f"a task is made already; {', '.join(options)} would have no effect")
    return make_task(**options) if task is None else task


def check_render_mode(mode: str | None) -> None:
    """Check a render mode.

    Raises:
        ValueError: it is neither None nor one of RENDER_MODES.
    """
    if mode is not None and mode not in RENDER_MODES:
        raise ValueError(f"render_mode: expected None or {', '.join(RENDER_MODES)}, got {mode!r}")


def spaces(task: RelayTask, vehicles: int) -> tuple[Box, Box]:
    """Observation and action space of this many vehicles."""
    entries = vehicles * len(task.features.names)
    return Box(-LIMIT, LIMIT, (entries,)), Box(-1.0, 1.0, (4 * vehicles,))
