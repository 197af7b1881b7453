"""The Gaussian model of readings (9)-(13), in the axes in which its covariance is diagonal.

    Y + epsilon = H theta + v,   v ~ N(0, Omega),   Omega = zeta^2 A (x) E + rho^2 I

with theta = (K, n), rows of H [1, -10 log10 l], A = exp(-|p - p'| / varphi) over the S transmitters and E likewise
over the N receivers. With A = U a U' and E = V e V', Omega has the eigenvalues zeta^2 a_i e_j + rho^2. If some
readings are missing, Omega is not a Kronecker product. The n existing readings are then treated as n receivers of a
single message, with the sum of the distances of both ends as their distance.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import torch
from torch import Tensor

from uwirl.world.acoustics import LinkBudget
from uwirl.world.geometry import distances
from uwirl.world.readings import Readings

# Smallest power, dB^2: logarithms and factorisations need a positive value.
NOISELESS = 1e-18


class UnidentifiableError(ValueError):
    """The readings cannot determine the path loss."""


class Geometry(NamedTuple):
    """Distances between the positions at which B data sets were read.

    Attributes:
        H: design matrix, [S, N, 2].
        apart: distances between transmitters, [S, S], m.
        spacing: distances between receivers, [N, N], m.
    """

    H: Tensor
    apart: Tensor
    spacing: Tensor

    @property
    def readings(self) -> int:
        """S N."""
        return self.H.shape[0] * self.H.shape[1]

    @property
    def span(self) -> float:
        """Largest distance between two links, m."""
        return float(torch.maximum(self.apart.max(), self.spacing.max()))


class Fading(NamedTuple):
    """Statistics of shadowing and multipath, numbers or [...].

    Attributes:
        zeta2: variance of the shadowing, dB^2.
        varphi: correlation distance of the shadowing, m.
        rho2: variance of the multipath, dB^2.
    """

    zeta2: Tensor
    varphi: Tensor
    rho2: Tensor

    @property
    def log(self) -> Tensor:
        """(ln zeta^2, ln varphi, ln rho^2), [..., 3]."""
        return torch.stack(list(self), -1).log()


class Spectrum(NamedTuple):
    """Eigenvalues and eigenvectors of A and E, for a correlation distance in each of the leading dimensions.

    Attributes:
        a, U: eigenvalues [..., S] and eigenvectors [..., S, S] of A.
        e, V: eigenvalues [..., N] and eigenvectors [..., N, N] of E.
    """

    a: Tensor
    U: Tensor
    e: Tensor
    V: Tensor

    @classmethod
    def of(cls, geometry: Geometry, varphi: Tensor) -> Spectrum:
        """The spectrum at correlation distances [...] in m."""
        apart, spacing = (torch.exp(-D / varphi[..., None, None]) for D in (geometry.apart, geometry.spacing))
        (a, U), (e, V) = torch.linalg.eigh(apart), torch.linalg.eigh(spacing)
        # Rounding errors make eigenvalues of nearly coincident positions negative.
        return cls(a.clamp_min(0.0), U, e.clamp_min(0.0), V)

    @property
    def eigenvalues(self) -> Tensor:
        """Eigenvalues of A (x) E, [..., S, N]."""
        return self.a[..., :, None] * self.e[..., None, :]

    def rotate(self, X: Tensor) -> Tensor:
        """(U (x) V)' X for X [..., S, N]."""
        return self.U.mT @ X @ self.V

    def rotate_design(self, H: Tensor) -> Tensor:
        """(U (x) V)' H for H [S, N, 2], [..., S, N, 2]."""
        return torch.stack([self.rotate(column) for column in H.unbind(-1)], -1)


def design(distance: Tensor) -> Tensor:
    """Rows of H, [1, -10 log10 l], for distances [...] in m, [..., 2]."""
    return torch.stack([torch.ones_like(distance), -10.0 * torch.log10(distance)], -1)


def observations(readings: Readings, budget: LinkBudget) -> Iterator[tuple[Tensor, Tensor, Geometry]]:
    """Groups of data sets with the same existing readings: numbers [b], Y + epsilon [b, S, N] and geometry.

    Raises:
        UnidentifiableError: fewer than three readings, or all over one distance, so that the slope is undetermined.
    """
    distance = readings.distance
    H = design(distance)
    log_distance = H[..., 1]
    y = readings.snr + budget.known_loss_dB(distance)
    heard = ~readings.snr.isnan()
    if not distance.numel():
        raise UnidentifiableError("nothing was heard: no sensor is within scenario.hearing_range_m")
    patterns, which = torch.unique(heard.flatten(1), dim=0, return_inverse=True)
    apart, spacing = (distances(x, x) for x in (readings.transmitters, readings.receivers))
    for k, pattern in enumerate(patterns):
        rows = (which == k).nonzero()[:, 0]
        _check_identifiable(log_distance.flatten()[pattern], distance.flatten()[pattern])
        if bool(pattern.all()):
            yield rows, y[rows], Geometry(H, apart, spacing)
            continue
        transmitter, receiver = pattern.view(heard.shape[1:]).nonzero().unbind(-1)
        between = apart[transmitter[:, None], transmitter] + spacing[receiver[:, None], receiver]
        there = y[rows].flatten(1)[:, None, pattern]
        yield rows, there, Geometry(H.flatten(0, 1)[None, pattern], between.new_zeros(1, 1), between)


def _check_identifiable(log_distance: Tensor, distance: Tensor) -> None:
    count = len(distance)
    if count < 3:
        raise UnidentifiableError(f"{count} readings cannot determine K, n and the fading: at least 3 are needed")
    if float(log_distance.max() - log_distance.min()) < 1e-9:
        raise UnidentifiableError(
            f"all {count} readings are over {float(distance[0]):g} m: K and n cannot be told apart from one distance"
        )


def generalized_least_squares(y: Tensor, H: Tensor, W: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """theta = (H' W H)^-1 H' W y, in coordinates in which W = Omega^-1 is diagonal.

    Args:
        y: rotated observations, [..., S, N].
        H: rotated design, [..., S, N, 2].
        W: diagonal, [..., S, N].

    Returns:
        theta [..., 2], its information H' W H [..., 2, 2], and the residual [..., S, N].
    """
    flat = H.flatten(-3, -2)
    weighted = W.flatten(-2)[..., None] * flat
    information = weighted.mT @ flat
    theta = torch.linalg.solve(information, (weighted.mT @ y.flatten(-2)[..., None])[..., 0])
    return theta, information, y - (H @ theta[..., None, :, None])[..., 0]
