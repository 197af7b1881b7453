"""Integration of the equations of motion (1) by the classical Runge-Kutta method, for a body with diagonal M and D.

Two forms do the same operations on each number. Eager PyTorch takes all rows of a state in one call, because the step
of one vehicle is a matter of calls: it takes half the time. A compiler fuses the step of single components into one
pass over memory, three times faster for many vehicles than that of rows.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor


class Body(NamedTuple):
    """Constants of a body in surge, sway, heave and yaw, [4, ...] each, in the shape of the rows of a state.

    Attributes:
        inertia: diagonal of M, added mass included, kg and kg m^2.
        linear_damping, quadratic_damping: diagonal of D(nu) = linear + quadratic |nu|.
    """

    inertia: Tensor
    linear_damping: Tensor
    quadratic_damping: Tensor


def column(values: Tensor, like: Tensor) -> Tensor:
    """Values of each axis, [4], in the shape of rows [4, ...]."""
    return values.view(-1, *[1] * (like.ndim - 1))


def rk4(body: Body, x: Tensor, force: Tensor, dt: float, out: Tensor | None = None) -> Tensor:
    """One step with the force held.

    Args:
        body: its constants.
        x: state x, y, z, psi, u, v, w, r, [8, ...].
        force: tau - g, [4, ...].
        dt: s.
        out: where to write the result; a new tensor if None.

    Returns:
        x after dt, [8, ...].
    """
    form = rk4_by_components if torch.compiler.is_compiling() else rk4_by_rows
    return form(body, x, force, dt, out)


def derivative(body: Body, y: Tensor, force: Tensor) -> Tensor:
    """Right-hand side of (1), [8, ...], at psi, u, v, w, r [5, ...]; it does not depend on the position."""
    m_u, m_v = body.inertia[0], body.inertia[1]
    psi, nu = y[0], y[1:]
    u, v, _, r = nu.unbind(0)
    c, s = torch.cos(psi), torch.sin(psi)
    damping = nu.abs() * body.quadratic_damping + body.linear_damping
    drive = torch.addcmul(force, damping, nu, value=-1.0)
    surge, sway, _, yaw = drive.unbind(0)
    # C(nu) nu = [-m_v v r, m_u u r, 0, (m_v - m_u) u v]
    surge.addcmul_(v, r * m_v)
    sway.addcmul_(u, r * m_u, value=-1.0)
    yaw.addcmul_(u, v * (m_u - m_v))
    x_dot, y_dot = torch.addcmul(c * u, s, v, value=-1.0), torch.addcmul(s * u, c, v)
    return torch.cat([x_dot[None], y_dot[None], nu[2:], drive.div_(body.inertia)])


def rk4_by_rows(body: Body, x: Tensor, force: Tensor, dt: float, out: Tensor | None = None) -> Tensor:
    """The form for eager execution, see `rk4`."""
    start = x[3:]
    k1 = derivative(body, start, force)
    k2 = derivative(body, torch.add(start, k1[3:], alpha=dt / 2), force)
    k3 = derivative(body, torch.add(start, k2[3:], alpha=dt / 2), force)
    k4 = derivative(body, torch.add(start, k3[3:], alpha=dt), force)
    return torch.add(x, torch.add(k1 + k4, k2 + k3, alpha=2.0), alpha=dt / 6, out=out)


def rk4_by_components(body: Body, x: Tensor, force: Tensor, dt: float, out: Tensor | None = None) -> Tensor:
    """The form for a compiler, see `rk4`."""
    m_u, m_v = body.inertia[0], body.inertia[1]
    forces, start = force.unbind(0), x.unbind(0)

    def slope(psi: Tensor, nu: Sequence[Tensor]) -> list[Tensor]:
        """As `derivative`, from and to single components, each [...]."""
        u, v, w, r = nu
        c, s = torch.cos(psi), torch.sin(psi)
        damping = zip(forces, body.linear_damping, body.quadratic_damping, nu, strict=True)
        drive = [torch.addcmul(f, x.abs() * quadratic + linear, x, value=-1.0) for f, linear, quadratic, x in damping]
        drive[0] = torch.addcmul(drive[0], v, r * m_v)
        drive[1] = torch.addcmul(drive[1], u, r * m_u, value=-1.0)
        drive[3] = torch.addcmul(drive[3], u, v * (m_u - m_v))
        nu_dot = [d / m for d, m in zip(drive, body.inertia, strict=True)]
        return [torch.addcmul(c * u, s, v, value=-1.0), torch.addcmul(s * u, c, v), w, r, *nu_dot]

    def after(previous: list[Tensor], h: float) -> list[Tensor]:
        psi, *nu = (torch.add(a, b, alpha=h) for a, b in zip(start[3:], previous[3:], strict=True))
        return slope(psi, nu)

    k1 = slope(start[3], start[4:])
    k2 = after(k1, dt / 2)
    k3 = after(k2, dt / 2)
    k4 = after(k3, dt)
    stages = zip(start, k1, k2, k3, k4, strict=True)
    steps = [torch.add(x0, torch.add(a + d, b + c, alpha=2.0), alpha=dt / 6) for x0, a, b, c, d in stages]
    return torch.stack(steps, out=out)
