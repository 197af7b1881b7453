"""Recursive least squares (eqs 30-31 and 48-49), batched over independent learners."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor


class RlsState(NamedTuple):
    """What the rows so far have taught.

    Attributes:
        weight: W, [L, n].
        P: [L, n, n].
    """

    weight: Tensor
    P: Tensor


@dataclass(frozen=True)
class RecursiveLeastSquares:
    """theta' W = y, one row at a time.

        gain = P theta / (kappa + theta' P theta)
        W   <- W + gain (y - theta' W)
        P   <- P - gain theta' P                    form="paper", (49) as printed
        P   <- (P - gain theta' P) / kappa          form="exponential"

    As printed, (31) and (49) lack 1/kappa. kappa is then no forgetting factor: W is exactly the ridge solution with
    penalty kappa / p0, whatever the order of the rows.

    Attributes:
        unknowns: n.
        learners: L, independent problems.
        kappa: > 0; with form="exponential" at most 1.
        p0: P starts as p0 I.
        form: "paper" or "exponential".
        dtype, device: of the state.

    Raises:
        ValueError: any other form or kappa.
    """

    unknowns: int
    learners: int = 1
    kappa: float = 1.0
    p0: float = 1e4
    form: str = "exponential"
    dtype: torch.dtype = torch.float64
    device: torch.device | str = "cpu"

    def __post_init__(self) -> None:
        if self.form not in ("paper", "exponential"):
            raise ValueError(f"form must be 'paper' or 'exponential', got {self.form!r}")
        if not 0.0 < self.kappa or (self.form == "exponential" and self.kappa > 1.0):
            raise ValueError(f"kappa must be positive, and at most 1 as a forgetting factor, got {self.kappa}")

    def init(self) -> RlsState:
        """W = 0 and P = p0 I."""
        weight = torch.zeros(self.learners, self.unknowns, dtype=self.dtype, device=self.device)
        P = (self.p0 * torch.eye(self.unknowns, dtype=self.dtype, device=self.device)).repeat(self.learners, 1, 1)
        return RlsState(weight, P)

    def update(self, state: RlsState, theta: Tensor, y: Tensor) -> RlsState:
        """Take in one row for each learner.

        Args:
            state: before it.
            theta: [L, n].
            y: [L].

        Returns:
            The state after it.
        """
        Ptheta = (state.P @ theta[..., None])[..., 0]
        gain = Ptheta / (self.kappa + (theta * Ptheta).sum(-1, keepdim=True))
        error = y - (theta * state.weight).sum(-1)
        P = state.P - gain[..., :, None] * Ptheta[..., None, :]
        return RlsState(
            state.weight + gain * error[..., None],
            P / self.kappa if self.form == "exponential" else P,
        )
