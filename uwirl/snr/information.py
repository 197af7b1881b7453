"""Fisher information of (K, n, ln zeta^2, ln varphi, ln rho^2), and the Cramer-Rao bound.

    I_theta = H' Omega^-1 H,   I_ab = tr(Omega^-1 Omega_a Omega^-1 Omega_b) / 2

where Omega_a is the derivative of Omega with respect to a logarithm of the fading. (15), (16) of the paper have a
matrix of rank one instead, for which the likelihood is unbounded.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from uwirl.snr.model import Fading, Geometry, Spectrum


class Derivatives(NamedTuple):
    """Derivatives of Omega, in its eigenvectors, for [...] values of the fading.

    Attributes:
        W: Omega^-1, a diagonal, [..., S, N].
        shadow: derivative with respect to ln zeta^2, a diagonal, [..., S, N].
        rho2: the derivative with respect to ln rho^2 is rho^2 I, [...].
        A, E: the derivative with respect to ln varphi is zeta^2 (A (x) diag e + diag a (x) E), with a and e from the
            spectrum; [..., S, S] and [..., N, N].
        spectrum: eigenvalues and eigenvectors.
        zeta2: zeta^2, dB^2, [...].
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
        """The derivatives for [...] values of the fading; the spectrum must belong to the same varphi."""

        def slope(D: Tensor, vectors: Tensor) -> Tensor:
            scaled = D / fading.varphi[..., None, None]
            return vectors.mT @ (scaled * torch.exp(-scaled)) @ vectors

        shadow = fading.zeta2[..., None, None] * spectrum.eigenvalues
        W = 1.0 / (shadow + fading.rho2[..., None, None])
        A, E = slope(geometry.apart, spectrum.U), slope(geometry.spacing, spectrum.V)
        return cls(W, shadow, fading.rho2, A, E, spectrum, fading.zeta2)

    @property
    def spread(self) -> Tensor:
        """Diagonal of the derivative with respect to ln varphi, [..., S, N]."""
        a, e = self.spectrum.a[..., :, None], self.spectrum.e[..., None, :]
        diagonal = (
            self.A.diagonal(dim1=-2, dim2=-1)[..., :, None] * e + a * self.E.diagonal(dim1=-2, dim2=-1)[..., None, :]
        )
        return self.zeta2[..., None, None] * diagonal

    def information(self) -> Tensor:
        """Fisher information I_ab of the log fading, [..., 3, 3]."""
        W, a, e = self.W, self.spectrum.a, self.spectrum.e
        noise, spread = self.rho2[..., None, None].expand_as(W), self.spread
        diagonals = torch.stack([self.shadow, spread, noise], -3) * W[..., None, :, :]
        flat = diagonals.flatten(-2)
        information = 0.5 * flat @ flat.mT
        # For ln varphi twice, the off-diagonal part contributes too.
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
        geometry: positions of the readings.
        fading: the true statistics, tensors without dimensions; all must be greater than 0.
    """
    spectrum = Spectrum.of(geometry, fading.varphi)
    derivatives = Derivatives.of(geometry, spectrum, fading)
    H = spectrum.rotate_design(geometry.H).flatten(0, 1)
    theta = H.mT @ (derivatives.W.flatten()[:, None] * H)
    bound = torch.zeros(5, 5, dtype=H.dtype, device=H.device)
    bound[:2, :2] = torch.linalg.inv(theta)
    bound[2:, 2:] = torch.linalg.inv(derivatives.information())
    return bound
