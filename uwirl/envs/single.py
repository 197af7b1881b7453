"""One world as a Gymnasium environment."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from gymnasium.error import ResetNeeded
from numpy.typing import NDArray

from uwirl.envs.episodes import Episodes, checked_action, of_worlds
from uwirl.envs.making import RENDER_MODES, check_render_mode, chosen_task, spaces
from uwirl.envs.task import RelayTask

Array = NDArray[np.float32]


class RelayEnv(gymnasium.Env[Any, Any]):
    """One agent that controls all M vehicles of a world.

    Observations [M F] and actions [4 M], float32, contain the vehicles' entries in chain order; the reward is the sum
    over the vehicles. docs/environments.md describes the entries.

    Args:
        task: the task; None creates it from the options.
        render_mode: None or "rgb_array".
        options: options of `uwirl.envs.making.make_task`.
    """

    metadata = {"render_modes": RENDER_MODES, "render_fps": 10}  # noqa: RUF012

    def __init__(self, task: RelayTask | None = None, *, render_mode: str | None = None, **options: Any):
        check_render_mode(render_mode)
        self.task, self.render_mode = chosen_task(task, options), render_mode
        self.observation_space, self.action_space = spaces(self.task, self.task.scenario.vehicles)
        self._episodes = Episodes(self.task, 1, keeps_paths=render_mode is not None)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """Begin the next episode, or the first one of a seed; options are ignored."""
        super().reset(seed=seed)
        self._episodes.begin(np.array([True]), self.np_random, [seed])
        return self._observation(), self._info()

    def step(self, action: Array) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        """Make one control step.

        Args:
            action: tau / tau_max, [4 M]; values are clipped to [-1, 1].

        Raises:
            ValueError: the action has another type or shape, or is not finite.
            ResetNeeded: no episode has begun, or it is over.
        """
        share = checked_action(action, (4 * self.task.scenario.vehicles,))
        if self._episodes.over[0]:
            raise ResetNeeded("no episode is under way: call reset() before step()")
        result = self._episodes.step(share.reshape(1, -1, 4))
        reward, ends = float(result.reward.sum()), (bool(result.terminated[0]), bool(result.truncated[0]))
        return self._observation(), reward, *ends, self._info()

    def render(self) -> NDArray[np.uint8] | None:
        """A picture of the world from above, [height, width, 3]; None without a render mode."""
        if self.render_mode is None:
            return None
        from uwirl.envs.picture import from_above

        return from_above(self.task.scenario, self._episodes.path(0), self._episodes.time(0))

    def _observation(self) -> Array:
        return self._episodes.observation().reshape(-1)

    def _info(self) -> dict[str, Any]:
        return {name: value[0].item() for name, value in of_worlds(self._episodes.infos()).items()}
