"""A vehicle's model as learned in flight: linear in its parameters theta.

    d/dt (P(nu) theta) + Q(nu) theta = tau

P theta is the momentum M nu, Q theta all other forces: Coriolis, damping, and the trim Q(0) theta. A `Regressor` says
which forces there may be, theta which of them a vehicle has.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import torch
from torch import Tensor


class Regressor(Protocol):
    """The structure of a model: what its parameters multiply."""

    @property
    def names(self) -> tuple[str, ...]:
        """Of the p parameters."""
        ...

    @property
    def positive(self) -> tuple[bool, ...]:
        """Whether each parameter can only be positive or zero, as inertia and damping are."""
        ...

    def momentum(self, nu: Tensor) -> Tensor:
        """P, [..., 4, p], linear in nu [..., 4]."""
        ...

    def force(self, nu: Tensor) -> Tensor:
        """Q, [..., 4, p], at nu [..., 4]."""
        ...


class Fossen:
    """The model (1): diagonal inertia with its C, linear and quadratic damping, net weight in heave; 13 parameters."""

    names = (
        *("m_u", "m_v", "m_w", "I_z"),
        *("d_u", "d_v", "d_w", "d_r"),
        *("d_uu", "d_vv", "d_ww", "d_rr"),
        "g_w",
    )
    positive = (True,) * 12 + (False,)

    def momentum(self, nu: Tensor) -> Tensor:
        """M nu, [..., 4, 13]."""
        return torch.nn.functional.pad(torch.diag_embed(nu), (0, 9))

    def force(self, nu: Tensor) -> Tensor:
        """C(nu) nu + D(nu) nu + g, [..., 4, 13]."""
        u, v, _, r = nu.unbind(-1)
        zero = torch.zeros_like(u)
        coriolis = torch.stack(
            [
                torch.stack([zero, -v * r, zero, zero], -1),
                torch.stack([u * r, zero, zero, zero], -1),
                torch.zeros_like(nu),
                torch.stack([-u * v, u * v, zero, zero], -1),
            ],
            -2,
        )
        heave = torch.stack([zero, zero, torch.ones_like(u), zero], -1)[..., None]
        return torch.cat([coriolis, torch.diag_embed(nu), torch.diag_embed(nu * nu.abs()), heave], -1)


@dataclass(frozen=True)
class VehicleModel:
    """The dynamics of K vehicles with learned parameters.

    Attributes:
        regressor: their structure.
        theta: [K, p].
        current: horizontal velocity of the water, [K, 2], m/s.
    """

    regressor: Regressor
    theta: Tensor
    current: Tensor

    @cached_property
    def inverse_inertia(self) -> Tensor:
        """M^-1, [K, 4, 4]."""
        axes = torch.eye(4, dtype=self.theta.dtype, device=self.theta.device)
        momentum = self.regressor.momentum(axes)  # [4 velocities, 4, p]
        return torch.linalg.inv(torch.einsum("jip,kp->kij", momentum, self.theta))

    @cached_property
    def trim(self) -> Tensor:
        """tau that holds the vehicles at rest in the water, [K, 4]."""
        return self.forces(torch.zeros_like(self.theta[:, :4]))

    def forces(self, nu: Tensor) -> Tensor:
        """Q(nu) theta, [..., K, 4], at nu [..., K, 4] through the water."""
        return (self.regressor.force(nu) @ self.theta[..., None])[..., 0]

    def select(self, rows: Tensor) -> VehicleModel:
        """The models of some vehicles, by their numbers."""
        return VehicleModel(self.regressor, self.theta[rows], self.current[rows])

    def rate(self, x: Tensor, effort: Tensor) -> Tensor:
        """dx/dt [..., K, 8] of x = (eta, nu) with nu through the water, and effort = tau - trim [..., K, 4]."""
        psi, (u, v) = x[..., 3], (x[..., 4], x[..., 5])
        c, s = torch.cos(psi), torch.sin(psi)
        drift = torch.stack([c * u - s * v, s * u + c * v], -1) + self.current
        acceleration = (self.inverse_inertia @ (effort + self.trim - self.forces(x[..., 4:]))[..., None])[..., 0]
        return torch.cat([drift, x[..., 6:8], acceleration], -1)

    def after(self, x: Tensor, effort: Tensor, dt: float) -> Tensor:
        """x [..., K, 8] after dt of held effort [..., K, 4], by a classical Runge-Kutta step."""
        k1 = self.rate(x, effort)
        k2 = self.rate(x + 0.5 * dt * k1, effort)
        k3 = self.rate(x + 0.5 * dt * k2, effort)
        k4 = self.rate(x + dt * k3, effort)
        return x + dt / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)

    def jacobian(self, x: Tensor) -> Tensor:
        """Derivative of `rate` by x, [..., K, 8, 8]."""
        psi, nu = x[..., 3], x[..., 4:]
        c, s = torch.cos(psi), torch.sin(psi)
        F = x.new_zeros(*x.shape, 8)
        F[..., 0, 3] = -s * nu[..., 0] - c * nu[..., 1]
        F[..., 1, 3] = c * nu[..., 0] - s * nu[..., 1]
        F[..., 0, 4], F[..., 0, 5], F[..., 1, 4], F[..., 1, 5] = c, -s, s, c
        F[..., 2, 6] = F[..., 3, 7] = 1.0
        axes = torch.eye(4, dtype=x.dtype, device=x.device)
        slopes = [torch.func.jvp(self.forces, (nu,), (axis.expand_as(nu).contiguous(),))[1] for axis in axes]
        F[..., 4:, 4:] = -self.inverse_inertia @ torch.stack(slopes, -1)
        return F
