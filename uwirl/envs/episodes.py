"""Successive episodes in a batch of worlds, as arrays: the common part of all environment classes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import torch
from gymnasium.error import ResetNeeded
from numpy.typing import NDArray
from torch import Tensor

from uwirl.envs.task import RelayTask, TaskState
from uwirl.study.evaluation import Evaluator
from uwirl.world.random import RandomStreams

Floats = NDArray[np.floating]
Flags = NDArray[np.bool_]
# Seeds are drawn below this if none is given, so that the following ones are valid seeds, too.
SEEDS = 2**31


class Result(NamedTuple):
    """Result of a control step.

    Attributes:
        reward: of each vehicle, [B, M], float64.
        terminated: [B].
        truncated: [B].
    """

    reward: Floats
    terminated: Flags
    truncated: Flags


def checked_action(action: Any, shape: tuple[int, ...]) -> Floats:
    """Check an action.

    Raises:
        ValueError: it has another type or shape, or a number that is not finite.
    """
    wanted = f"the action must be a floating-point array of shape {shape} with entries from -1 to 1"
    if not isinstance(action, np.ndarray):
        raise ValueError(f"{wanted}, got {type(action).__name__}")
    if action.shape != shape or not np.issubdtype(action.dtype, np.floating):
        raise ValueError(f"{wanted}, got {action.dtype} of shape {action.shape}")
    if not np.isfinite(action).all():
        place = tuple(int(k) for k in np.argwhere(~np.isfinite(action))[0])
        raise ValueError(f"{wanted}, got {action[place]} at {place}")
    return action


class Episodes:
    """One episode at a time in each of B worlds.

    Episode k after a seed uses the random numbers of world k of that seed (`uwirl.world.random`), whatever the batch.

    Args:
        task: the task.
        worlds: number of worlds B.
        keeps_paths: whether to store the vehicles' paths, for pictures.
    """

    def __init__(self, task: RelayTask, worlds: int, keeps_paths: bool = False):
        self.task = task
        self.seed = np.zeros(worlds, dtype=np.int64)
        # -1 before the first episode.
        self.number = np.full_like(self.seed, -1)
        self.over: Flags = np.ones(worlds, dtype=np.bool_)
        self._judge: Evaluator | None = None
        self._state: TaskState | None = None
        self._paths: list[Tensor] | None = [] if keeps_paths else None
        self._began = np.zeros(worlds, dtype=np.int64)

    @torch.no_grad()
    def begin(self, mask: Flags, random: np.random.Generator, seeds: Sequence[int | None] | None = None) -> None:
        """Begin the next episode in some worlds, or the first one of a new seed.

        Args:
            mask: worlds in which to begin, [B].
            random: draws seeds for worlds that have none.
            seeds: seeds of all worlds; only masked ones are used. None keeps the present seeds.

        Raises:
            ValueError: a seed is invalid.
        """
        given = [(row, seed) for row, seed in enumerate(seeds or ()) if mask[row] and seed is not None]
        for row, seed in given:
            self.seed[row], self.number[row] = _checked_seed(seed), -1
        self.number[mask] += 1
        unknown = mask & (self.number == 0)
        unknown[[row for row, _ in given]] = False
        self.seed[unknown] = random.integers(SEEDS, size=int(unknown.sum()))
        device = self.task.scenario.source.device
        streams = RandomStreams(torch.tensor(self.seed, device=device), torch.tensor(self.number, device=device))
        judge, index = self.task.worlds(streams), torch.tensor(np.flatnonzero(mask), device=device)
        if self._state is None or mask.all():
            self._state = self.task.begin(judge)
        else:
            self._state = self._state.replaced(index, self.task.begin(self.task.worlds(streams.select(index))))
        self._judge, self.over = judge, self.over & ~mask
        if self._paths is not None:
            self._began[mask] = len(self._paths)
            self._paths.append(self._state.world.vehicles.eta.clone())

    @torch.no_grad()
    def step(self, action: Floats) -> Result:
        """Make one control step in all worlds, also in those whose episode is over.

        Args:
            action: checked action, [B, M, 4].
        """
        judge, state = self._now()
        # A copy, because the given array may be changed later, be read-only or have negative strides.
        share = torch.from_numpy(np.array(action, order="C")).to(state.stage)
        self._state, (reward, terminated, truncated) = self.task.step(judge, state, share)
        if self._paths is not None:
            self._paths.append(self._state.world.vehicles.eta.clone())
        result = Result(*(x.numpy(force=True) for x in (reward, terminated, truncated)))
        self.over = self.over | result.terminated | result.truncated
        return result

    @torch.no_grad()
    def observation(self) -> NDArray[np.float32]:
        """Observations [B, M, F], a new array."""
        return self.task.observe(*self._now()).numpy(force=True)

    @torch.no_grad()
    def infos(self) -> dict[str, NDArray[Any]]:
        """Infos about each vehicle [B, M] and about the chain [B]; new arrays."""
        judge, state = self._now()
        capacity = judge.truth.link_capacities_kbps(state.world.vehicles.position).amin(-1)
        named = {
            "J": state.cost,
            "contacts": state.contacts,
            "clearance_m": state.clearance.double(),
            "blocked": state.blocked,
            "chain_capacity_kbps": capacity.double(),
        }
        return {name: value.clone().numpy(force=True) for name, value in named.items()}

    def path(self, world: int) -> Floats:
        """eta at every control step of the present episode, [n + 1, M, 4].

        Raises:
            ResetNeeded: no episode has begun.
            ValueError: paths are not stored.
        """
        self._now()
        if self._paths is None:
            raise ValueError("paths are kept with render_mode='rgb_array' alone")
        return torch.stack([eta[world] for eta in self._paths[self._began[world] :]]).numpy(force=True)

    def time(self, world: int) -> float:
        """Time since the beginning of the episode, s."""
        return float(self._now()[1].world.step[world]) * self.task.scenario.dt

    def _now(self) -> tuple[Evaluator, TaskState]:
        if self._judge is None or self._state is None:
            raise ResetNeeded("nothing has begun: call reset() first")
        return self._judge, self._state


def of_worlds(infos: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Infos about worlds, [B]: sums of costs and contacts, smallest clearance, whether any vehicle is blocked."""
    return {
        "J": infos["J"].sum(1),
        "contacts": infos["contacts"].sum(1),
        "clearance_m": infos["clearance_m"].min(1),
        "blocked": infos["blocked"].any(1),
        "chain_capacity_kbps": infos["chain_capacity_kbps"],
    }


def _checked_seed(seed: Any) -> int:
    if not isinstance(seed, int | np.integer) or not 0 <= seed < 2**63:
        raise ValueError(f"a seed must be an integer in [0, 2^63), got {seed!r}")
    return int(seed)
