"""Any control-affine system x_dot = f(x) + g(x) tau, given as a batched callable, as a source of experience."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

# x [..., n], tau [..., m] -> x_dot [..., n]
Dynamics = Callable[[Tensor, Tensor], Tensor]
# x [..., n], t in s -> tau [..., m]
Control = Callable[[Tensor, float], Tensor]


def simulate(dynamics: Dynamics, control: Control, x0: Tensor, dt: float, steps: int) -> tuple[Tensor, Tensor]:
    """Integrate by RK4 under a control that is continuous in time, not held.

    Args:
        dynamics: right-hand side.
        control: evaluated at every Runge-Kutta stage.
        x0: [..., n].
        dt: s.
        steps: number of steps.

    Returns:
        States [steps + 1, ..., n] and controls [steps + 1, ..., m] at the nodes.
    """
    x, states, controls = x0, [x0], [control(x0, 0.0)]
    for step in range(steps):
        t = step * dt

        def slope(y: Tensor, at: float) -> Tensor:
            return dynamics(y, control(y, at))

        k1 = slope(x, t)
        k2 = slope(x + dt / 2 * k1, t + dt / 2)
        k3 = slope(x + dt / 2 * k2, t + dt / 2)
        k4 = slope(x + dt * k3, t + dt)
        x = x + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        states.append(x)
        controls.append(control(x, t + dt))
    return torch.stack(states), torch.stack(controls)
