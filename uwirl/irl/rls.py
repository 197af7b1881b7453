"""Recursive least squares (eqs 30-31 and 48-49), batched over independent learners."""

from __future__ import annotations

import torch
from torch import Tensor, nn


class RecursiveLeastSquares(nn.Module):
    """theta' W = y, one row at a time.

        gain = P theta / (kappa + theta' P theta)
        W   <- W + gain (y - theta' W)
        P   <- P - gain theta' P                    form="paper", (49) as printed
        P   <- (P - gain theta' P) / kappa          form="exponential"

    As printed, (31) and (49) lack 1/kappa. kappa is then no forgetting factor: W is exactly the ridge solution with
    penalty kappa / p0, whatever the order of the rows.

    Args:
        unknowns: n.
        learners: L, independent problems.
        kappa: > 0; with form="exponential" at most 1.
        p0: P starts as p0 I.
        form: "paper" or "exponential".
    """

    def __init__(
        self,
        unknowns: int,
        learners: int = 1,
        kappa: float = 1.0,
        p0: float = 1e4,
        form: str = "exponential",
        dtype: torch.dtype = torch.float64,
    ):
        super().__init__()
        if form not in ("paper", "exponential"):
            raise ValueError(f"form must be 'paper' or 'exponential', got {form!r}")
        if not 0.0 < kappa or (form == "exponential" and kappa > 1.0):
            raise ValueError(f"kappa must be positive, and at most 1 as a forgetting factor, got {kappa}")
        self.kappa = kappa
        self.form = form
        self.weight: Tensor
        self.P: Tensor
        self.register_buffer("weight", torch.zeros(learners, unknowns, dtype=dtype))
        self.register_buffer("P", (p0 * torch.eye(unknowns, dtype=dtype)).repeat(learners, 1, 1))

    def update(self, theta: Tensor, y: Tensor) -> Tensor:
        """Take in one row for each learner.

        Args:
            theta: [L, n].
            y: [L].

        Returns:
            The weights, [L, n].
        """
        Ptheta = (self.P @ theta[..., None])[..., 0]
        gain = Ptheta / (self.kappa + (theta * Ptheta).sum(-1, keepdim=True))
        error = y - (theta * self.weight).sum(-1)
        self.weight = self.weight + gain * error[..., None]
        P = self.P - gain[..., :, None] * Ptheta[..., None, :]
        self.P = P / self.kappa if self.form == "exponential" else P
        return self.weight
