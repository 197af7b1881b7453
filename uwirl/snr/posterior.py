"""What readings leave open about the fading: its posterior on a grid.

The means of L distinct links with c readings each have the covariance

    Omega = rho^2 M,   M = gamma R + D^-1,   R = exp(-(|p - p'| + |q - q'|) / varphi),   gamma = zeta^2 / rho^2

where D is diagonal and holds c. theta = (K, n) has a flat prior and rho^2 the prior 1 / rho^2. Both are integrated
analytically: the likelihood becomes the restricted one, and predictions follow Student's t with m - 2 degrees of
freedom. ln varphi and ln gamma have flat priors, between 0.4 and 100 % of the largest distance between two links and
between -9 and 9: neither a scale nor a kind of fading is preferred.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import torch
from scipy import special
from torch import Tensor

from uwirl.snr.likelihood import LOG_RATIO, LONGEST, RATIOS, SHORTEST, VARPHIS
from uwirl.snr.links import Links
from uwirl.snr.model import NOISELESS, Fading

# If u' P u is below this fraction of u' Omega^-1 u, path loss can explain all of an offset along u.
NOTHING = 1e-9
# The finer grid covers the nodes of the coarse one whose marginal weight is more than this share of the largest.
TAIL = 1e-4
FINE_VARPHIS, FINE_RATIOS = 11, 25
BISECTIONS = 60


class Axes(NamedTuple):
    """Coordinates in which M is diagonal for one correlation distance and all ratios.

    Attributes:
        varphi: m, [].
        eigenvalues: of D^1/2 R D^1/2, [L].
        vectors: D^1/2 times its eigenvectors, [L, L].
        y: observations, [B, L].
        H: design matrix, [L, 2].
    """

    varphi: Tensor
    eigenvalues: Tensor
    vectors: Tensor
    y: Tensor
    H: Tensor

    @classmethod
    def of(cls, links: Links, varphi: Tensor) -> Axes:
        """The axes at a correlation distance in m."""
        root = links.repeats.sqrt()
        covariance = root[:, None] * torch.exp(links.apart(links.first, links.second) / -varphi) * root
        eigenvalues, vectors = torch.linalg.eigh(covariance)
        vectors = root[:, None] * vectors
        return cls(varphi, eigenvalues.clamp_min(0.0), vectors, links.y @ vectors, vectors.mT @ links.H)

    def precision(self, ratio: Tensor) -> Tensor:
        """M^-1, a diagonal, [G, L]."""
        return 1.0 / (1.0 + ratio[:, None] * self.eigenvalues)


class Beliefs(NamedTuple):
    """K distributions of the fading over P correlation distances and G ratios, for each of B data sets.

    Attributes:
        weight: probabilities of the nodes, [B, P, G, K].
        scale: rho^2 is `freedom` times this over a chi squared number, [B, P, G, K], dB^2.
        freedom: degrees of freedom; infinite if rho^2 is known.
    """

    weight: Tensor
    scale: Tensor
    freedom: float

    @property
    def rho2(self) -> Tensor:
        """Expected rho^2 at each node, [B, P, G, K], dB^2."""
        # It is infinite for fewer than five readings, which are believed as five are.
        return self.scale if math.isinf(self.freedom) else self.scale * self.freedom / max(self.freedom - 2.0, 1.0)

    def mean(self, values: Tensor) -> Tensor:
        """Expectation of [B, P, G, K], [B, K]."""
        return (self.weight * values).sum((1, 2))

    def beyond(self, t: Tensor) -> Tensor:
        """Probability that numbers with this scale exceed |t|, on either side, [B, K], for t [B, P, G, K]."""
        tail = special.stdtr(self.freedom, -t.abs().numpy(force=True))
        return 2.0 * self.mean(torch.from_numpy(tail).to(t))


@dataclass(frozen=True)
class FadingPosterior:
    """Posterior of B data sets on a grid of P correlation distances and G ratios gamma.

    Attributes:
        links: the readings.
        log_varphi: [P].
        log_ratio: ln gamma, [G].
        axes: P of them.
        theta: best K and n at each node, [B, P, G, 2].
        inverse: of theta's information times rho^2, [P, G, 2, 2].
        half_logdet: half of ln det(M) + ln det(H' M^-1 H) up to a constant, [P, G].
        squares: sum of squares that are left, times rho^2, [B, P, G], dB^2.
        rho2: if it is known, [].
    """

    links: Links
    log_varphi: Tensor
    log_ratio: Tensor
    axes: tuple[Axes, ...]
    theta: Tensor
    inverse: Tensor
    half_logdet: Tensor
    squares: Tensor
    rho2: Tensor | None = None

    @classmethod
    def coarse(cls, links: Links) -> FadingPosterior:
        """Over all fading that the prior allows."""
        span = float(links.apart(links.first, links.second).max())
        like = links.y.new_tensor
        varphi = torch.linspace(math.log(SHORTEST * span), math.log(LONGEST * span), VARPHIS)
        return cls.on(links, like(varphi.tolist()), like(torch.linspace(-LOG_RATIO, LOG_RATIO, RATIOS).tolist()))

    @classmethod
    def known(cls, links: Links, fading: Fading) -> FadingPosterior:
        """Of fading that is known: a single node."""
        zeta2, varphi, rho2 = (torch.as_tensor(x).to(links.y).reshape(1) for x in fading)
        rho2 = rho2.clamp_min(NOISELESS)
        return cls.on(links, varphi.log(), (zeta2 / rho2).log(), rho2[0])

    @classmethod
    def on(cls, links: Links, log_varphi: Tensor, log_ratio: Tensor, rho2: Tensor | None = None) -> FadingPosterior:
        """On a given grid, with equal steps."""
        axes = tuple(Axes.of(links, varphi) for varphi in log_varphi.exp())
        nodes = [_nodes(each, log_ratio.exp()) for each in axes]
        theta, inverse, half_logdet, squares = (list(parts) for parts in zip(*nodes, strict=True))
        total = torch.stack(squares, 1) + links.within[:, None, None]
        return cls(
            links,
            log_varphi,
            log_ratio,
            axes,
            theta=torch.stack(theta, 1),
            inverse=torch.stack(inverse),
            half_logdet=torch.stack(half_logdet),
            squares=total.clamp_min(links.readings * NOISELESS),
            rho2=rho2,
        )

    def refined(self) -> FadingPosterior:
        """On a grid of the same prior where, for any of the data sets, the fading may be."""
        weight = self.beliefs.weight[..., 0]
        varphi = _around(self.log_varphi, weight.sum(2), FINE_VARPHIS)
        return FadingPosterior.on(self.links, varphi, _around(self.log_ratio, weight.sum(1), FINE_RATIOS))

    @property
    def freedom(self) -> float:
        """Degrees of freedom of rho^2."""
        return math.inf if self.rho2 is not None else self.links.readings - 2.0

    @property
    def beliefs(self) -> Beliefs:
        """The posterior, K = 1."""
        return self._beliefs(self.squares[..., None], self.half_logdet[..., None], self.freedom)

    def without(self, product: Tensor, information: Tensor) -> Beliefs:
        """Posteriors if an offset of unknown size is added along K directions u, one at a time.

        An offset that may be anything takes away what the readings say along its direction: with P as in
        `uwirl.snr.diagnostics`, the sum of squares loses (u' P y)^2 / (u' P u).

        Args:
            product: rho^2 u' P y, [B, P, G, K].
            information: rho^2 u' P u, [P, G, K].
        """
        squares = self.squares[..., None] - product.square() / information
        squares = squares.clamp_min(self.links.readings * NOISELESS)
        return self._beliefs(squares, self.half_logdet[..., None] + 0.5 * information.log(), self.freedom - 1.0)

    def _beliefs(self, squares: Tensor, half_logdet: Tensor, freedom: float) -> Beliefs:
        if self.rho2 is not None:
            scale = self.rho2.expand_as(squares)
            return Beliefs(torch.ones_like(scale), scale, math.inf)
        cost = 0.5 * freedom * squares.log() + half_logdet
        # Trapezoidal rule.
        ends = [_ends(len(x)).to(cost) for x in (self.log_varphi, self.log_ratio)]
        cost = cost - (ends[0][:, None] * ends[1]).log()[..., None]
        weight = torch.softmax(-cost.flatten(1, 2), 1).view_as(cost)
        return Beliefs(weight, squares / freedom, freedom)

    def along(self, directions: Tensor) -> tuple[Tensor, Tensor]:
        """rho^2 u' P y, [B, P, G, K], and rho^2 u' P u, [P, G, K], of directions u in the space of links, [L, K].

        The second is nan if path loss explains an offset along u as well.
        """
        products, informations = [], []
        for p, axes in enumerate(self.axes):
            W, u = axes.precision(self.log_ratio.exp()), axes.vectors.mT @ directions
            residual = axes.y[:, None] - self.theta[:, p] @ axes.H.mT
            products.append((W * residual) @ u)
            along_H = (W[..., None] * axes.H).mT @ u
            all_of_it = W @ u.square()
            left = all_of_it - (along_H * (self.inverse[p] @ along_H)).sum(-2)
            informations.append(torch.where(left > NOTHING * all_of_it, left, torch.nan))
        return torch.stack(products, 1), torch.stack(informations)

    def semivariance(self, distance: Tensor) -> Tensor:
        """Expected rho^2 + zeta^2 (1 - exp(-d / varphi)) of the first data set, dB^2, for distances [k] in m."""
        rise = -torch.expm1(distance / -self.log_varphi.exp()[:, None])
        at_nodes = 1.0 + self.log_ratio.exp()[:, None] * rise[:, None]
        beliefs = self.beliefs
        return beliefs.mean(beliefs.rho2 * at_nodes)[0]

    def intervals(self, coverage: float = 0.95) -> Tensor:
        """Equal-tailed intervals of zeta^2, varphi and rho^2, [B, 3, 2]."""
        beliefs = self.beliefs
        ends = []
        for share in (0.5 - 0.5 * coverage, 0.5 + 0.5 * coverage):
            rho2 = self._quantile(torch.zeros_like(self.log_ratio), share)
            varphi = _share(self.log_varphi, beliefs.weight[..., 0].sum(2), share).exp()
            ends.append(torch.stack([self._quantile(self.log_ratio, share), varphi, rho2], -1))
        return torch.stack(ends, -1)

    def _quantile(self, log_factor: Tensor, share: float) -> Tensor:
        """Quantile of exp(log_factor) rho^2, [B], for log_factor [G]."""
        beliefs, freedom = self.beliefs, self.freedom
        weight, scale = beliefs.weight[..., 0], beliefs.scale[..., 0]
        typical = scale.log() + log_factor
        # Beyond, rho^2 is not within the factor exp(30) of its scale.
        low, high = typical.amin((1, 2)) - 30.0, typical.amax((1, 2)) + 30.0
        for _ in range(BISECTIONS):
            middle = 0.5 * (low + high)
            ratio = (typical - middle[:, None, None]).exp().numpy(force=True)
            below = torch.from_numpy(special.gammaincc(0.5 * freedom, 0.5 * freedom * ratio)).to(weight)
            less = (weight * below).sum((1, 2)) < share
            low, high = torch.where(less, middle, low), torch.where(less, high, middle)
        return (0.5 * (low + high)).exp()


def _nodes(axes: Axes, ratio: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """theta [B, G, 2], inverse [G, 2, 2], half_logdet [G] and squares of the links' means [B, G]."""
    W = axes.precision(ratio)
    weighted = W[..., None] * axes.H
    information = weighted.mT @ axes.H
    inverse = torch.linalg.inv(information)
    theta = (axes.y @ weighted @ inverse).transpose(0, 1)
    residual = axes.y[:, None] - theta @ axes.H.mT
    half_logdet = 0.5 * (torch.linalg.slogdet(information).logabsdet - W.log().sum(-1))
    return theta, inverse, half_logdet, (W * residual.square()).sum(-1)


def _ends(count: int) -> Tensor:
    """Shares of the nodes of the trapezoidal rule."""
    share = torch.ones(count)
    if count > 1:
        share[[0, -1]] = 0.5
    return share


def _around(x: Tensor, weight: Tensor, count: int) -> Tensor:
    """A finer line over the nodes x [n] that matter, for weights [B, n]."""
    most = (weight / weight.amax(-1, keepdim=True)).amax(0)
    matter = (most > TAIL).nonzero()[:, 0]
    low, high = x[(matter[0] - 1).clamp_min(0)], x[(matter[-1] + 1).clamp_max(len(x) - 1)]
    return low + (high - low) * torch.linspace(0.0, 1.0, count).to(x)


def _share(x: Tensor, weight: Tensor, share: float) -> Tensor:
    """Where the cumulative weight [B, n] of nodes x [n] reaches a share, [B]."""
    # Half of a node's weight lies on either side of it.
    below = weight.cumsum(-1) - 0.5 * weight
    k = torch.searchsorted(below, below.new_full((len(below), 1), share)).clamp(1, len(x) - 1)
    a, b = below.gather(1, k - 1), below.gather(1, k)
    part = ((share - a) / (b - a)).clamp(0.0, 1.0)
    return (x[k - 1] + part * (x[k] - x[k - 1]))[:, 0]
