"""Kriging that does not take the fading for known: predictions are averages over its posterior.

At each node of the grid of `uwirl.snr.posterior` this is universal kriging, see `uwirl.snr.kriging`. The mean is that
of the nodes' means. The variance, by the law of total variance, is the mean of the nodes' variances plus the variance
of their means. Shadowing that cannot be told from multipath then widens the prediction.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import torch
from scipy import special
from torch import Tensor

from uwirl.snr.links import Links
from uwirl.snr.model import design
from uwirl.snr.posterior import Axes, FadingPosterior
from uwirl.world.acoustics import LinkBudget
from uwirl.world.readings import Readings

# Entries of a chunk's correlations with the links, and of its predictions at the nodes for all data sets.
CHUNK_ENTRIES = 2**20


class _Prediction(NamedTuple):
    """Mean [B, G, Q] in dB and variance over rho^2 [G, Q], at one correlation distance."""

    mean: Tensor
    variance: Tensor


class IntegratedKriging:
    """Predicts the SNR of other links from B data sets.

    Args:
        posterior: of the fading.
        budget: what is known of links beforehand.
    """

    def __init__(self, posterior: FadingPosterior, budget: LinkBudget):
        self.posterior, self.budget = posterior, budget
        self.beliefs = posterior.beliefs

    @classmethod
    def of(cls, readings: Readings, budget: LinkBudget) -> IntegratedKriging:
        """From readings, on a grid that suits them."""
        return cls(FadingPosterior.coarse(Links.of(readings, budget)).refined(), budget)

    def mean(self, first: Tensor, second: Tensor) -> Tensor:
        """The mean alone, [B, Q], dB, at a small part of the computing time.

        Args:
            first, second: ends of the links in the order of the field, [3] or [Q, 3], m.
        """
        posterior, weight = self.posterior, self.beliefs.weight[..., 0]
        theta = torch.einsum("bpg,bpgi->bi", weight, posterior.theta)
        # Weights of the residuals, averaged over the ratios of each correlation distance, [B, P, L].
        residual = torch.stack(
            [
                torch.einsum("bg,gl,bgl->bl", weight[:, p], self._pull(axes), self._residual(axes, p)) @ axes.vectors.mT
                for p, axes in enumerate(posterior.axes)
            ],
            1,
        )
        parts = []
        for a, b in self._chunks(first, second):
            apart = posterior.links.apart(a, b)
            pulled = sum(residual[:, p] @ torch.exp(apart / -axes.varphi).mT for p, axes in enumerate(posterior.axes))
            h, known = self._known(a, b)
            parts.append(theta @ h.mT - known + pulled)
        return torch.cat(parts, -1)

    def predict(self, first: Tensor, second: Tensor, multipath: bool = False) -> tuple[Tensor, Tensor]:
        """Mean and standard deviation of the SNR, [B, Q] each, dB.

        Args:
            first, second: ends of the links in the order of the field, [3] or [Q, 3], m.
            multipath: whether to predict a reading, with multipath, or the link's shadowed SNR.
        """
        parts = []
        for a, b in self._chunks(first, second):
            mean, square = (self.beliefs.weight.new_zeros(()) for _ in range(2))
            for p, at in self._at_nodes(a, b):
                weight, rho2 = (x[:, p] for x in (self.beliefs.weight, self.beliefs.rho2))
                mean = mean + (weight * at.mean).sum(1)
                square = square + (weight * (at.mean.square() + rho2 * (at.variance + float(multipath)))).sum(1)
            parts.append((mean, (square - mean.square()).clamp_min(0.0).sqrt()))
        mean, std = (torch.cat(pieces, -1) for pieces in zip(*parts, strict=True))
        return mean, std

    def below(self, first: Tensor, second: Tensor, snr_dB: float) -> Tensor:
        """Probability, [B, Q], that the shadowed SNR of links is below a value."""
        parts = []
        for a, b in self._chunks(first, second):
            probability = self.beliefs.weight.new_zeros(())
            for p, at in self._at_nodes(a, b):
                scale = (self.beliefs.scale[:, p] * at.variance).sqrt()
                t = ((snr_dB - at.mean) / scale).numpy(force=True)
                cumulative = torch.from_numpy(special.stdtr(self.beliefs.freedom, t)).to(scale)
                probability = probability + (self.beliefs.weight[:, p] * cumulative).sum(1)
            parts.append(probability)
        return torch.cat(parts, -1)

    def _chunks(self, first: Tensor, second: Tensor) -> Iterator[tuple[Tensor, Tensor]]:
        links, weight = self.posterior.links, self.beliefs.weight
        count = max(len(end) if end.ndim == 2 else 1 for end in (first, second))
        first, second = (end.to(links.y).expand(count, 3) for end in (first, second))
        chunk = max(1, CHUNK_ENTRIES // max(len(links.repeats), len(weight) * weight.shape[2]))
        return zip(first.split(chunk), second.split(chunk), strict=True)

    def _known(self, first: Tensor, second: Tensor) -> tuple[Tensor, Tensor]:
        """Rows of H, [Q, 2], and epsilon, [Q], of links."""
        distance = torch.linalg.vector_norm(first - second, dim=-1)
        return design(distance), self.budget.known_loss_dB(distance)

    def _pull(self, axes: Axes) -> Tensor:
        """gamma M^-1, a diagonal, [G, L]."""
        ratio = self.posterior.log_ratio.exp()
        return ratio[:, None] * axes.precision(ratio)

    def _residual(self, axes: Axes, p: int) -> Tensor:
        """[B, G, L]."""
        return axes.y[:, None] - self.posterior.theta[:, p] @ axes.H.mT

    def _at_nodes(self, first: Tensor, second: Tensor) -> Iterator[tuple[int, _Prediction]]:
        posterior = self.posterior
        apart, (h, known) = posterior.links.apart(first, second), self._known(first, second)
        ratio = posterior.log_ratio.exp()[:, None]
        for p, axes in enumerate(posterior.axes):
            k, pull = torch.exp(apart / -axes.varphi) @ axes.vectors, self._pull(axes)
            mean = posterior.theta[:, p] @ h.mT - known + (pull * self._residual(axes, p)) @ k.mT
            d = h - k @ (pull[..., None] * axes.H)
            variance = ratio - (ratio * pull) @ k.square().mT + ((d @ posterior.inverse[p]) * d).sum(-1)
            yield p, _Prediction(mean, variance.clamp_min(0.0))
