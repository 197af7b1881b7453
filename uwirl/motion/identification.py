"""Parameters of a vehicle from its own flight, by integral regressors and recursive least squares.

Over a window from t to t + T, the model of `uwirl.motion.vehicle_model` integrates to

    (P(nu(t + T)) - P(nu(t))) theta + int Q(nu) theta dt = int tau dt

so no acceleration is needed, and noise of the velocity enters at the window's ends alone. There it makes inertia appear
smaller than it is; windows share their ends, so its variance shows in the covariance of their residuals, and least
squares are corrected by it (T. Soderstrom, "Errors-in-variables methods in system identification", Automatica 43(6),
2007). Rows weigh the inverse of their axis' residual; damping and inertia that come out negative are zero. Standard
errors allow for residuals that differ in size and that windows share (Newey and West, Econometrica 55(3), 1987).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from uwirl.irl.rls import RecursiveLeastSquares
from uwirl.motion.vehicle_model import Regressor, VehicleModel
from uwirl.world.geometry import turned_to_body
from uwirl.world.trajectory import Trajectory

# Times that rows are weighed anew by their residuals.
ROUNDS = 3
# Windows on either side whose residuals may be alike.
NEIGHBOURS = 2
# Error that the integrals' rule may leave in a parameter without noise, as a share of it.
RULE = 0.002
# Gauss-Newton steps to the current, and the difference by which slopes are found, m/s.
STEPS, STEP = 2, 0.01


class Rows(NamedTuple):
    """Windows of a flight: regressor theta = impulse.

    Attributes:
        regressor: [W, 4, p].
        impulse: integral of tau, [W, 4].
    """

    regressor: Tensor
    impulse: Tensor

    @classmethod
    def joined(cls, parts: list[Rows]) -> Rows:
        """Rows of several flights."""
        return cls(*(torch.cat(part) for part in zip(*parts, strict=True)))


class Identified(NamedTuple):
    """What a flight tells about its vehicle.

    Attributes:
        theta: [p].
        std: standard errors, [p].
        current: horizontal velocity of the water, [2], m/s.
        current_std: its standard errors, [2], m/s.
    """

    theta: Tensor
    std: Tensor
    current: Tensor
    current_std: Tensor

    def model(self, regressor: Regressor, device: torch.device) -> VehicleModel:
        """The model of one vehicle, [1]."""
        return VehicleModel(regressor, self.theta.to(device)[None], self.current.to(device)[None])

    def items(self, names: tuple[str, ...]) -> list[tuple[str, float, float]]:
        """Name, value and standard error of each parameter, and of the current's two components."""
        values, stds = torch.cat([self.theta, self.current]), torch.cat([self.std, self.current_std])
        return list(zip((*names, "current_x", "current_y"), values.tolist(), stds.tolist(), strict=True))

    def doubtful_inertia(self, regressor: Regressor, most: float) -> list[str]:
        """Names of parameters of inertia whose standard error is more than so large a share of them."""
        inertia = regressor.momentum(torch.eye(4)).abs().sum((0, 1)) > 0.0
        names = [name for name, is_inertia in zip(regressor.names, inertia.tolist(), strict=True) if is_inertia]
        return [name for name in self.doubtful(regressor.names, most) if name in names]

    def doubtful(self, names: tuple[str, ...], most: float) -> list[str]:
        """Names of parameters other than zero whose standard error is more than so large a share of them."""
        share = self.std / self.theta.abs()
        return [name for name, x, s in zip(names, self.theta.tolist(), share.tolist(), strict=True) if x and s > most]


@dataclass(frozen=True)
class Windows:
    """How a flight is cut into windows.

    Attributes:
        regressor: of the model.
        dt: of the flight's steps, s.
        steps: of a window.
        stride: steps between the beginnings of windows.
        depth: of the water, m: windows with contact to surface or floor tell nothing.
    """

    regressor: Regressor
    dt: float
    steps: int
    stride: int
    depth: float

    def rows(self, eta: Tensor, nu: Tensor, tau: Tensor, theta: Tensor | None = None) -> Rows:
        """Rows of vehicles flown side by side.

        Args:
            eta: [n + 1, L, 4].
            nu: velocity through the water, [n + 1, L, 4].
            tau: held over each step, [n, L, 4].
            theta: a first estimate [p], with which integrals are by Simpson's rule; by the trapezoid without.
        """
        begin = torch.arange(0, len(tau) - self.steps + 1, self.stride, device=tau.device)
        end = begin + self.steps
        momentum, force = self.regressor.momentum(nu), self.regressor.force(nu)
        mean = 0.5 * self.dt * (force[1:] + force[:-1])
        if theta is not None:
            # As tau is held, accelerations at the ends of a step differ by the forces' change alone.
            axes = self.regressor.momentum(torch.eye(4, dtype=nu.dtype, device=nu.device)) @ theta
            bend = torch.linalg.solve(axes.T, ((force[1:] - force[:-1]) @ theta)[..., None])[..., 0]
            middle = 0.5 * (nu[1:] + nu[:-1]) + self.dt / 8.0 * bend
            mean = mean / 3.0 + 2.0 / 3.0 * self.dt * self.regressor.force(middle)
        so_far = torch.cat([torch.zeros_like(force[:1]), mean.cumsum(0)])
        pushed = torch.cat([torch.zeros_like(tau[:1]), (self.dt * tau).cumsum(0)])
        afloat = (eta[..., 2] < 0.0) & (eta[..., 2] > -self.depth)
        aground = torch.nn.functional.pad((~afloat).long().cumsum(0), (0, 0, 1, 0))
        free = aground[end + 1] == aground[begin]
        regressor = momentum[end] - momentum[begin] + so_far[end] - so_far[begin]
        return Rows(regressor[free], (pushed[end] - pushed[begin])[free])


class Log(NamedTuple):
    """A flight of L vehicles: eta and nu over ground [n + 1, L, 4], tau [n, L, 4]."""

    eta: Tensor
    nu: Tensor
    tau: Tensor

    @classmethod
    def of(cls, flown: Trajectory) -> Log:
        """All vehicles of a flight, which are alike."""
        return cls(*(x.double().flatten(1, 2) for x in (flown.states.eta, flown.states.nu, flown.tau)))

    @classmethod
    def joined(cls, logs: Sequence[Log]) -> Log:
        """Logs, each of which continues the one before, as one."""
        eta, nu = (torch.cat([logs[0][k], *(log[k][1:] for log in logs[1:])]) for k in (0, 1))
        return cls(eta, nu, torch.cat([log.tau for log in logs]))

    def through(self, current: Tensor) -> Log:
        """The same with nu through water that moves at a current [2], m/s."""
        velocity = torch.nn.functional.pad(current, (0, 2)).expand_as(self.nu)
        return self._replace(nu=self.nu - turned_to_body(velocity, self.eta[..., 3]))


def identify_flights(windows: Windows, logs: list[Log], scale: Tensor, current: Tensor) -> Identified | None:
    """Parameters of vehicles that are alike, and the current, from their flights; None while these tell too little.

    For a given current all else is least squares, so the current is found by Gauss-Newton steps on what these leave.

    Args:
        windows: how flights are cut.
        logs: the flights, in one constant current.
        scale: see `identify`.
        current: where the search begins, [2], m/s.
    """

    def known(c: Tensor) -> tuple[Identified, Tensor]:
        flights = [log.through(c) for log in logs]
        first = identify(Rows.joined([windows.rows(*log) for log in flights]), windows.regressor, scale).theta
        rows = Rows.joined([windows.rows(*log, first) for log in flights])
        found = identify(rows, windows.regressor, scale)
        return found, rows.regressor @ found.theta - rows.impulse

    if sum(len(windows.rows(*log).regressor) for log in logs) <= len(windows.regressor.names):
        return None
    try:
        return _with_current(known, scale, current)
    except torch.linalg.LinAlgError:
        # Some parameters have no influence on what was flown.
        return None


def _with_current(known: Callable[[Tensor], tuple[Identified, Tensor]], scale: Tensor, current: Tensor) -> Identified:
    """What is known with the current that leaves the least; `known` gives it, and residuals, for any current."""
    found, residual = known(current)
    # Weights of this search are those of its beginning, so that it minimises one sum.
    weight = 1.0 / residual.square().mean(0).sqrt().clamp_min(1e-6 * scale.to(residual))
    for _ in range(STEPS):
        ahead = [known(current + STEP * axis)[1] for axis in torch.eye(2).to(current)]
        slope = torch.stack([(other - residual) * weight for other in ahead], -1).flatten(0, 1) / STEP
        information = slope.T @ slope
        change = -torch.linalg.solve(information, slope.T @ (residual * weight).flatten())
        tried, left = known(current + change)
        if not float((left * weight).square().sum()) < float((residual * weight).square().sum()):
            break
        current, found, residual = current + change, tried, left
    std = torch.linalg.inv(information).diagonal().sqrt()
    return found._replace(current=current, current_std=std)


def identify(rows: Rows, regressor: Regressor, scale: Tensor) -> Identified:
    """Weighted least squares over all rows.

    Args:
        rows: of one vehicle.
        regressor: says which parameters are positive.
        scale: of each axis' forces, [4], for the first weights.

    Raises:
        ValueError: fewer windows than parameters.
    """
    Y, b = rows.regressor.double(), rows.impulse.double()
    W, _, p = Y.shape
    if W < p:
        raise ValueError(f"{W} windows of flight for {p} parameters: fly longer")
    weight = (1.0 / scale).to(Y)
    positive = torch.tensor(regressor.positive, device=Y.device)
    momentum = regressor.momentum(torch.eye(4, dtype=Y.dtype, device=Y.device))  # [4 velocities, 4, p]
    variance = Y.new_zeros(4)
    for _ in range(ROUNDS):
        heavy = momentum * weight[:, None]
        noise = 2.0 * torch.einsum("j,jap,jaq->pq", variance, heavy, heavy)
        free = torch.ones(p, dtype=torch.bool, device=Y.device)
        while True:
            theta, P = _solved(Y * weight[:, None] * free, b * weight)
            theta, P = _without_noise(theta, P, W * noise * free[:, None] * free)
            theta = torch.where(free, theta, 0.0)
            negative = positive & free & (theta < 0.0)
            if not bool(negative.any()):
                break
            free &= ~negative
        residual = (Y @ theta) - b
        used, given = weight, residual
        shared = -(residual[1:] * residual[:-1]).mean(0)
        inertia = torch.diagonal(momentum @ theta)
        variance = (shared / inertia.square().clamp_min(1e-12)).clamp_min(0.0)
        weight = 1.0 / residual.square().mean(0).sqrt().clamp_min(1e-9 * scale.to(Y))
    score = torch.einsum("wap,wa->wp", Y * used[:, None], given * used)
    spread = score.T @ score
    for lag in range(1, NEIGHBOURS + 1):
        both = score[lag:].T @ score[:-lag]
        spread = spread + (1.0 - lag / (NEIGHBOURS + 1.0)) * (both + both.T)
    covariance = P @ spread @ P
    std = covariance.diagonal().clamp_min(0.0).sqrt() * (W / (W - p / 4.0)) ** 0.5
    still = theta.new_zeros(2)
    return Identified(theta, torch.where(free, std + RULE * theta.abs(), 0.0), still, still)


def _solved(Y: Tensor, b: Tensor) -> tuple[Tensor, Tensor]:
    """Least squares of rows [W, 4, p] by RLS; also (Y'Y)^-1, [p, p]."""
    A, c = Y.flatten(0, 1), b.flatten()
    # Columns of one size, so that the start of P is as weak for all.
    size = A.norm(dim=0).clamp_min(1e-12)
    rls = RecursiveLeastSquares(A.shape[1], p0=1e8, device=str(A.device))
    state = rls.init()
    # The triangular factor of all rows tells the same as they do, and takes p updates.
    Q, R = torch.linalg.qr(A / size)
    for row, value in zip(R[:, None], (Q.T @ c)[:, None], strict=True):
        state = rls.update(state, row, value)
    return state.weight[0] / size, state.P[0] / size[:, None] / size


def _without_noise(theta: Tensor, P: Tensor, noise: Tensor) -> tuple[Tensor, Tensor]:
    """Least squares whose rows' squares hold so much noise [p, p] too much."""
    size = torch.diagonal(P).sqrt()
    information = torch.linalg.inv(P / size[:, None] / size)
    less = information - noise * size[:, None] * size
    right = information @ (theta / size)
    return torch.linalg.solve(less, right) * size, torch.linalg.inv(less) * size[:, None] * size
