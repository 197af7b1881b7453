"""Fisher information of (K, n, ln zeta^2, ln varphi, ln rho^2), and the Cramer-Rao bound.

    I_theta = H' Omega^-1 H,   I_ab = tr(Omega^-1 Omega_a Omega^-1 Omega_b) / 2

where Omega_a is the derivative of Omega with respect to a logarithm of the fading. (15), (16) of the paper have a
matrix of rank one instead, with which the likelihood is unbounded.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from uwirl.snr.model import Fading, Geometry, Spectrum


class Derivatives(NamedTuple):
    """Of Omega in its own axes, for [...] settings of the fading.

    Attributes:
        W: Omega^-1, a diagonal, [..., S, N].
        shadow: derivative by ln zeta^2, a diagonal, [..., S, N].
        rho2: derivative by ln rho^2 is rho^2 I, [...].
        A, E: with a, e and zeta^2 of the derivative by ln varphi, which is zeta^2 (A (x) diag e + diag a (x) E);
            [..., S, S] and [..., N, N].
        spectrum: as named.
        zeta2: [...].
    """

    W: Tensor
    shadow: Tensor
    rho2: Tensor
    A: Tensor
    E: Tensor
    spectrum: Spectrum
    zeta2: Tensor

    @classmethod
    def of(cls, geometry: Geometry, spectrum: Spectrum, fading: Fading) -> Derivatives:
        """All of [...] settings, of which the spectrum belongs to varphi."""

        def slope(D: Tensor, vectors: Tensor) -> Tensor:
            scaled = D / fading.varphi[..., None, None]
            return vectors.mT @ (scaled * torch.exp(-scaled)) @ vectors

        shadow = fading.zeta2[..., None, None] * spectrum.eigenvalues
        W = 1.0 / (shadow + fading.rho2[..., None, None])
        A, E = slope(geometry.apart, spectrum.U), slope(geometry.spacing, spectrum.V)
        return cls(W, shadow, fading.rho2, A, E, spectrum, fading.zeta2)

    @property
    def spread(self) -> Tensor:
        """Diagonal of the derivative by ln varphi, [..., S, N]."""
        a, e = self.spectrum.a[..., :, None], self.spectrum.e[..., None, :]
        diagonal = (
            self.A.diagonal(dim1=-2, dim2=-1)[..., :, None] * e + a * self.E.diagonal(dim1=-2, dim2=-1)[..., None, :]
        )
        return self.zeta2[..., None, None] * diagonal

    def information(self) -> Tensor:
        """I_ab, [..., 3, 3]."""
        W, a, e = self.W, self.spectrum.a, self.spectrum.e
        noise, spread = self.rho2[..., None, None].expand_as(W), self.spread
        diagonals = torch.stack([self.shadow, spread, noise], -3) * W[..., None, :, :]
        flat = diagonals.flatten(-2)
        information = 0.5 * flat @ flat.mT
        # By ln varphi twice, the part off the diagonal counts too.
        We, Wa = W * e[..., None, :], W * a[..., :, None]
        A, E = (X.square() * (1.0 - torch.eye(X.shape[-1], dtype=X.dtype, device=X.device)) for X in (self.A, self.E))
        off = ((A @ We) * We).sum((-2, -1)) + ((Wa @ E) * Wa).sum((-2, -1))
        information[..., 1, 1] += 0.5 * self.zeta2.square() * off
        return information

    def quadratic_forms(self, x: Tensor) -> Tensor:
        """x' Omega_a x for each of the three, [..., 3], of rotated vectors [..., S, N]."""
        a, e = self.spectrum.a[..., :, None], self.spectrum.e[..., None, :]
        along_varphi = self.zeta2 * (((self.A @ x) * x * e).sum((-2, -1)) + ((x @ self.E) * x * a).sum((-2, -1)))
        along_zeta = (self.shadow * x.square()).sum((-2, -1))
        return torch.stack([along_zeta, along_varphi, self.rho2 * x.square().sum((-2, -1))], -1)

    def traces(self) -> Tensor:
        """tr(Omega^-1 Omega_a), [..., 3]."""
        parts = [self.W * self.shadow, self.W * self.spread, self.W * self.rho2[..., None, None]]
        return torch.stack([part.sum((-2, -1)) for part in parts], -1)


def cramer_rao_bound(geometry: Geometry, fading: Fading) -> Tensor:
    """Least covariance of an unbiased estimate of (K, n, ln zeta^2, ln varphi, ln rho^2), [5, 5].

    Args:
        geometry: where is read.
        fading: the true statistics, numbers as tensors of no dimension; all must be greater than 0.
    """
    spectrum = Spectrum.of(geometry, fading.varphi)
    derivatives = Derivatives.of(geometry, spectrum, fading)
    H = spectrum.rotate_design(geometry.H).flatten(0, 1)
    theta = H.mT @ (derivatives.W.flatten()[:, None] * H)
    bound = torch.zeros(5, 5, dtype=H.dtype, device=H.device)
    bound[:2, :2] = torch.linalg.inv(theta)
    bound[2:, 2:] = torch.linalg.inv(derivatives.information())
    return bound
