"""Integrals over windows of equally spaced samples."""

from __future__ import annotations

from torch import Tensor


def _windows(f: Tensor, length: int, stride: int) -> Tensor:
    """[n, ...] -> [S, ..., length]."""
    if f.shape[0] < length:
        raise ValueError(f"a window of {length} samples does not fit into {f.shape[0]} samples")
    return f.unfold(0, length, stride)


def simpson(f: Tensor, dt: float, steps: int, stride: int) -> Tensor:
    """Composite Simpson rule over windows of an even number of steps; for integrands continuous across the window.

    Args:
        f: samples at the nodes, [n + 1, ...].
        dt: spacing of the nodes, s.
        steps: steps per window, even.
        stride: steps between the starts of two windows.

    Returns:
        [S, ...], one integral a window.

    Raises:
        ValueError: an odd number of steps, or a window longer than the samples.
    """
    if steps % 2:
        raise ValueError(f"Simpson's rule needs an even number of steps in a window, got {steps}")
    weights = f.new_full((steps + 1,), 2.0)
    weights[1::2] = 4.0
    weights[0] = weights[-1] = 1.0
    return _windows(f, steps + 1, stride) @ weights * (dt / 3.0)


def held_product(phi: Tensor, tau: Tensor, dt: float, steps: int, stride: int) -> Tensor:
    """Integral of phi tau where tau is held over each step: sum of tau_j times the trapezoid of phi over step j.

    Simpson's rule over node products would treat the jumps of a held tau as smooth (error 6e-2 against 1e-4).

    Args:
        phi: [n + 1, ..., k], at the nodes.
        tau: [n, ..., k], held from node j to node j + 1.
        dt, steps, stride: as in `simpson`.

    Returns:
        [S, ..., k].
    """
    per_step = tau * (phi[1:] + phi[:-1]) * (dt / 2.0)
    return _windows(per_step, steps, stride).sum(-1)


def drop(phi: Tensor, steps: int, stride: int) -> Tensor:
    """phi(t) - phi(t + T) for each window, [S, ...], of node values [n + 1, ...]."""
    ends = _windows(phi, steps + 1, stride)
    return ends[..., 0] - ends[..., -1]
