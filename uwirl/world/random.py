"""Counter-based random numbers: every draw is a pure function of (seed, stream, world, step).

World i therefore draws the same numbers whatever the batch size, and a resumed run needs no generator state.
The generator is Philox4x32-10 (Salmon, Moraes, Dror, Shaw: "Parallel random numbers: as easy as 1, 2, 3", SC'11).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import torch
from torch import Tensor

_MULTIPLIERS = (0xD2511F53, 0xCD9E8D57)
_WEYL = (0x9E3779B9, 0xBB67AE85)
_MASK = 0xFFFFFFFF


class Stream(IntEnum):
    """Independent sources of randomness in one world."""

    CHANNEL = 0
    MEASUREMENT = 1
    INITIAL_STATE = 2
    EXPLORATION = 3
    DISTURBANCE = 4
    SENSOR_PLACEMENT = 5
    LAYOUT = 6
    NAVIGATION = 7
    LINKS = 8


def philox4x32(counter: Tensor, key: Tensor, rounds: int = 10) -> Tensor:
    """Philox4x32 block function.

    Args:
        counter: 32-bit words in int64, [..., 4].
        key: 32-bit words in int64, [..., 2], broadcast against the counter.
        rounds: 10 is the published default.

    Returns:
        Four random 32-bit words in int64, [..., 4].
    """
    (c0, c1, c2, c3), (k0, k1) = counter.unbind(-1), key.unbind(-1)
    return torch.stack(_mixed(c0, c1, c2, c3, k0, k1, rounds), -1)


def _mixed(
    c0: Tensor, c1: Tensor, c2: Tensor, c3: Tensor, k0: Tensor, k1: Tensor, rounds: int = 10
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """The rounds of `philox4x32` on single words, [...] each, which broadcast."""
    number = torch.arange(rounds, device=k0.device)
    keys = [((k[..., None] + weyl * number) & _MASK).unbind(-1) for k, weyl in zip((k0, k1), _WEYL, strict=True)]
    shape = torch.broadcast_shapes(*(word.shape for word in (c0, c1, c2, c3, k0, k1)))
    c0, c2 = c0.expand(shape), c2.expand(shape)
    for k0, k1 in zip(*keys, strict=True):
        # int64 products wrap modulo 2^64, which keeps both 32-bit halves right.
        p0, p1 = c0 * _MULTIPLIERS[0], c2 * _MULTIPLIERS[1]
        c0 = (p1 >> 32).bitwise_xor_(c1).bitwise_xor_(k0).bitwise_and_(_MASK)
        c2 = (p0 >> 32).bitwise_xor_(c3).bitwise_xor_(k1).bitwise_and_(_MASK)
        c1, c3 = p1.bitwise_and_(_MASK), p0.bitwise_and_(_MASK)
    return c0, c1, c2, c3


@dataclass(frozen=True)
class RandomStreams:
    """The random numbers of B worlds.

    Attributes:
        seed: int64 [B].
        world: int64 [B], which world of that seed each row is.
    """

    seed: Tensor
    world: Tensor

    @classmethod
    def worlds(cls, seed: int, count: int, device: torch.device | str = "cpu") -> RandomStreams:
        """Worlds 0 ... count-1 of one seed."""
        world = torch.arange(count, device=device)
        return cls(torch.full_like(world, seed), world)

    @classmethod
    def replicates(cls, seeds: Sequence[int], device: torch.device | str = "cpu") -> RandomStreams:
        """World 0 of each of several seeds: the same numbers as in separate runs with those seeds."""
        seed = torch.tensor(list(seeds), device=device)
        return cls(seed, torch.zeros_like(seed))

    def select(self, index: Tensor) -> RandomStreams:
        """The random numbers of some worlds, by their indices [K] in the batch."""
        return RandomStreams(self.seed[index], self.world[index])

    def uniform(self, stream: Stream, step: int | Tensor, count: int) -> Tensor:
        """Uniform float64 draws in [0, 1), [B, count], for a step that is a number or int64 [B].

        With a single world, several steps may be given.
        """
        blocks = torch.arange((count + 1) // 2, device=self.seed.device)
        at = step if isinstance(step, Tensor) else self.world.new_full((), step)
        world, at, seed = (x[:, None] for x in torch.broadcast_tensors(self.world, at, self.seed))
        counter = world & _MASK, at & _MASK, torch.full_like(blocks, int(stream)), blocks
        words = _mixed(*counter, seed & _MASK, (seed >> 32) & _MASK)
        # 53 bits from two words, as the Mersenne Twister's genrand_res53 does.
        mantissa = torch.stack([(high >> 5).mul_(1 << 26).add_(low >> 6) for high, low in (words[:2], words[2:])], -1)
        return (mantissa.to(torch.float64) / (1 << 53)).flatten(1)[:, :count]

    def between(self, stream: Stream, step: int | Tensor, low: float, high: float, count: int) -> Tensor:
        """Uniform float64 draws in [low, high), [B, count]."""
        return low + (high - low) * self.uniform(stream, step, count)

    def normal(self, stream: Stream, step: int | Tensor, count: int) -> Tensor:
        """Standard normal float64 draws by Box-Muller, [B, count]."""
        u = self.uniform(stream, step, count + count % 2).unflatten(1, (-1, 2))
        radius = torch.sqrt(-2.0 * torch.log1p(-u[..., 0]))
        angle = 2.0 * math.pi * u[..., 1]
        draws = torch.stack([radius * torch.cos(angle), radius * torch.sin(angle)], -1)
        return draws.flatten(1)[:, :count]
