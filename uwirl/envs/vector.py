"""Many worlds as a Gymnasium vector environment, all stepped as one batch."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from uwirl.envs.episodes import Episodes, checked_action, of_worlds
from uwirl.envs.making import RENDER_MODES, check_render_mode, chosen_task, spaces
from uwirl.envs.task import RelayTask

Array = NDArray[Any]


class RelayVectorEnv(VectorEnv[Array, Array, Array]):
    """B worlds; each behaves exactly like a `RelayEnv` with the same seed.

    Args:
        task: the task; None creates it from the options.
        num_envs: B.
        render_mode: None or "rgb_array".
        autoreset_mode: when a world begins the next episode after its end: at the next step, whose action it ignores
            (Gymnasium's default), in the same step, whose `infos` then contain `final_obs` and `final_info`, or never.
        options: options of `uwirl.envs.making.make_task`.

    Raises:
        ValueError: num_envs is not positive, or a mode is unknown.
    """

    metadata = {"render_modes": RENDER_MODES, "render_fps": 10, "autoreset_mode": AutoresetMode.NEXT_STEP}  # noqa: RUF012

    def __init__(
        self,
        task: RelayTask | None = None,
        num_envs: int = 1,
        *,
        render_mode: str | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        **options: Any,
    ):
        if num_envs < 1:
            raise ValueError(f"num_envs: must be at least 1, got {num_envs}")
        check_render_mode(render_mode)
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.metadata = self.metadata | {"autoreset_mode": self.autoreset_mode}
        self.task, self.num_envs, self.render_mode = chosen_task(task, options), num_envs, render_mode
        self.single_observation_space, self.single_action_space = spaces(self.task, self.task.scenario.vehicles)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._episodes = Episodes(self.task, num_envs, keeps_paths=render_mode is not None)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """Begin the next episode in all worlds, or in those with a true `options["reset_mask"]`.

        Args:
            seed: seed of the first world, increased by one for each further world, or one seed for each; None
                continues with the next episode.
            options: a reset_mask, bool [B]; the other worlds are unchanged and have no entries in `infos`.

        Raises:
            ValueError: the mask or the seeds are invalid, or a world without an episode is left out.
        """
        mask = _checked_mask((options or {}).get("reset_mask"), self.num_envs)
        if not mask.all() and (self._episodes.number[~mask] < 0).any():
            raise ValueError("reset_mask: the first reset must be of all worlds")
        seeds: Sequence[int | None] | None = None
        if seed is None or isinstance(seed, int | np.integer):
            first = None if seed is None else int(seed)
            super().reset(seed=first)
            seeds = None if first is None else range(first, first + self.num_envs)
        elif len(seed) == self.num_envs:
            seeds = seed
        else:
            raise ValueError(f"seed: {self.num_envs} are needed, one for each world, got {len(seed)}")
        self._episodes.begin(mask, self.np_random, seeds)
        return self._observations(), self._infos(mask)

    def step(self, actions: Array) -> tuple[Array, Array, Array, Array, dict[str, Any]]:
        """Make one control step in all worlds.

        Args:
            actions: tau / tau_max, [B, 4 M]; values are clipped to [-1, 1].

        Raises:
            ValueError: the actions have another type or shape, or are not finite.
            ResetNeeded: no episode has begun, or one is over and there is no autoreset.
        """
        share = checked_action(actions, (self.num_envs, 4 * self.task.scenario.vehicles))
        waiting = self._episodes.over
        if waiting.any() and (self.autoreset_mode != AutoresetMode.NEXT_STEP or (self._episodes.number < 0).any()):
            raise ResetNeeded(f"no episode is under way in {int(waiting.sum())} worlds: call reset() before step()")
        result = self._episodes.step(share.reshape(self.num_envs, -1, 4))
        reward, terminated, truncated = result.reward.sum(1), result.terminated, result.truncated
        if waiting.any():
            reward[waiting], terminated[waiting], truncated[waiting] = 0.0, False, False
            self._episodes.begin(waiting, self.np_random)
        ended, final = terminated | truncated, {}
        if self.autoreset_mode == AutoresetMode.SAME_STEP and ended.any():
            final = self._final(ended)
            self._episodes.begin(ended, self.np_random)
        everywhere = np.ones(self.num_envs, dtype=np.bool_)
        return self._observations(), reward, terminated, truncated, self._infos(everywhere) | final

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """Pictures of all worlds from above, [height, width, 3] each; None without a render mode."""
        if self.render_mode is None:
            return None
        from uwirl.envs.picture import from_above

        episodes = self._episodes
        return tuple(from_above(self.task.scenario, episodes.path(i), episodes.time(i)) for i in range(self.num_envs))

    def _observations(self) -> Array:
        return self._episodes.observation().reshape(self.num_envs, -1)

    def _infos(self, mask: NDArray[np.bool_]) -> dict[str, Any]:
        """Arrays [B], each with a mask `_name` of the worlds with a value, as in Gymnasium."""
        infos: dict[str, Any] = {}
        for name, values in of_worlds(self._episodes.infos()).items():
            infos[name], infos[f"_{name}"] = np.where(mask, values, np.zeros_like(values)), mask.copy()
        return infos

    def _final(self, ended: NDArray[np.bool_]) -> dict[str, Any]:
        """Entries of `infos` about ended episodes, if the next ones begin in the same step."""
        last, observations = np.full(self.num_envs, None, dtype=object), self._observations()
        for row in np.flatnonzero(ended):
            last[row] = observations[row].copy()
        final = {"final_obs": last, "final_info": self._infos(ended)}
        return final | {f"_{name}": ended.copy() for name in final}


def _checked_mask(mask: Any, worlds: int) -> NDArray[np.bool_]:
    if mask is None:
        return np.ones(worlds, dtype=np.bool_)
    if not isinstance(mask, np.ndarray) or mask.dtype != np.bool_ or mask.shape != (worlds,) or not mask.any():
        raise ValueError(f"reset_mask: must be a bool array of shape ({worlds},) that is true somewhere, got {mask!r}")
    return mask
