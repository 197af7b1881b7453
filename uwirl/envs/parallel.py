"""One world as a PettingZoo environment with one agent per vehicle."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.spaces import Box
from numpy.typing import NDArray
from pettingzoo import ParallelEnv

from uwirl.envs.episodes import Episodes, checked_action
from uwirl.envs.making import RENDER_MODES, check_render_mode, chosen_task, spaces
from uwirl.envs.task import RelayTask

Array = NDArray[np.float32]


class RelayParallelEnv(ParallelEnv[str, Array, Array]):
    """M vehicles, each with its own observation [F], action [4] and reward.

    They are called vehicle_0 to vehicle_{M - 1}, in chain order from the source. An episode ends for all together.

    Args:
        task: the task; None creates it from the options.
        render_mode: None or "rgb_array".
        options: options of `uwirl.envs.making.make_task`.
    """

    metadata = {"name": "uwirl_relay_v0", "render_modes": RENDER_MODES, "render_fps": 10, "is_parallelizable": True}  # noqa: RUF012

    def __init__(self, task: RelayTask | None = None, *, render_mode: str | None = None, **options: Any):
        check_render_mode(render_mode)
        self.task, self.render_mode = chosen_task(task, options), render_mode
        self.possible_agents = [f"vehicle_{i}" for i in range(self.task.scenario.vehicles)]
        self.agents: list[str] = []
        both = {agent: spaces(self.task, 1) for agent in self.possible_agents}
        self.observation_spaces = {agent: observed for agent, (observed, _) in both.items()}
        self.action_spaces = {agent: acted for agent, (_, acted) in both.items()}
        self._episodes = Episodes(self.task, 1, keeps_paths=render_mode is not None)
        self._random = np.random.default_rng()

    def observation_space(self, agent: str) -> Box:
        """The space, always the same object."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> Box:
        """The space, always the same object."""
        return self.action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Array], dict[str, dict[str, Any]]]:
        """Begin the next episode, or the first one of a seed; options are ignored."""
        self._episodes.begin(np.array([True]), self._random, [seed])
        self.agents = list(self.possible_agents)
        return self._observations(), self._infos()

    def step(
        self, actions: Mapping[str, Array]
    ) -> tuple[dict[str, Array], dict[str, float], dict[str, bool], dict[str, bool], dict[str, dict[str, Any]]]:
        """Make one control step.

        Args:
            actions: tau / tau_max of every vehicle, [4] each; values are clipped to [-1, 1].

        Raises:
            ValueError: a vehicle has no action, a name is unknown, or an action has another type or shape, or is not
                finite.
            ResetNeeded: no episode has begun, or it is over.
        """
        if self._episodes.over[0]:
            raise ResetNeeded("no episode is under way: call reset() before step()")
        if actions.keys() != set(self.agents):
            raise ValueError(f"actions are needed of {', '.join(self.agents)}, got {', '.join(actions) or 'none'}")
        share = np.stack([_action_of(agent, actions[agent]) for agent in self.agents])
        result = self._episodes.step(share[None])
        acted = self.agents
        rewards = dict(zip(acted, result.reward[0].tolist(), strict=True))
        terminations = dict.fromkeys(acted, bool(result.terminated[0]))
        truncations = dict.fromkeys(acted, bool(result.truncated[0]))
        if self._episodes.over[0]:
            self.agents = []
        return self._observations(), rewards, terminations, truncations, self._infos()

    def render(self) -> NDArray[np.uint8] | None:
        """A picture of the world from above, [height, width, 3]; None without a render mode."""
        if self.render_mode is None:
            return None
        from uwirl.envs.picture import from_above

        return from_above(self.task.scenario, self._episodes.path(0), self._episodes.time(0))

    def state(self) -> Array:
        """The observations of all vehicles in chain order, [M F]."""
        return self._episodes.observation().reshape(-1)

    def _observations(self) -> dict[str, Array]:
        # Copies, so that one vehicle's array is not a view of all.
        rows = self._episodes.observation()[0]
        return {agent: row.copy() for agent, row in zip(self.possible_agents, rows, strict=True)}

    def _infos(self) -> dict[str, dict[str, Any]]:
        """Infos of each vehicle, with the chain's capacity."""
        infos = {name: value[0] for name, value in self._episodes.infos().items()}
        return {
            agent: {name: (value[i] if value.ndim else value).item() for name, value in infos.items()}
            for i, agent in enumerate(self.possible_agents)
        }


def _action_of(agent: str, action: Any) -> Array:
    try:
        return checked_action(action, (4,)).astype(np.float32)
    except ValueError as error:
        raise ValueError(f"{agent}: {error}") from None
