"""Estimators of the channel from readings; one interface, `estimate(readings, budget) -> ChannelEstimate`.

Each takes B data sets with the same positions of senders and receivers; any readings may be missing.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, Protocol

import torch
from torch import Tensor

from uwirl.snr import likelihood, model
from uwirl.snr.estimate import ChannelEstimate
from uwirl.snr.information import Derivatives
from uwirl.snr.likelihood import MAX_ENTRIES, ordinary
from uwirl.snr.model import Fading, Geometry, Spectrum, observations
from uwirl.snr.moments import moment_fit
from uwirl.world.acoustics import Channel, LinkBudget
from uwirl.world.agent import InterfaceError
from uwirl.world.readings import Readings, readings_of_each_vehicle
from uwirl.world.relay import Relay

# Largest standard deviation of the logarithm of an identifiable parameter: a factor of two in either direction.
SEPARABLE = 0.75
# `separate` stops when theta changes by less than this fraction of its standard error, or after ROUNDS rounds.
SETTLED, ROUNDS = 1e-3, 20


class Estimator(Protocol):
    """Estimates (K, n) and the fading.

    Args:
        readings: B data sets.
        budget: what a vehicle knows beforehand (N0, bandwidth, absorption).

    Raises:
        UnidentifiableError: fewer than three readings, or all over the same distance.
    """

    def __call__(self, readings: Readings, budget: LinkBudget) -> ChannelEstimate: ...


def estimate_each_vehicle(env: Relay, estimator: Estimator) -> tuple[list[Readings], ChannelEstimate]:
    """Stage 1 in the first world: each vehicle's readings and its estimate from them, [M] data sets."""
    readings = readings_of_each_vehicle(env)
    return readings, ChannelEstimate.join([_checked(estimator(data, env.budget)) for data in readings])


def _checked(estimate: object) -> ChannelEstimate:
    """One data set's estimate, if it is one."""
    if not isinstance(estimate, ChannelEstimate):
        raise InterfaceError(f"estimator must return a ChannelEstimate, got a {type(estimate).__name__}")
    shapes = {"value": (1, 5), "covariance": (1, 5, 5), "identifiable": (1, 5), "cost": (1,)}
    for name, shape in shapes.items():
        got = getattr(estimate, name)
        if not isinstance(got, Tensor) or got.shape != shape:
            shown = list(got.shape) if isinstance(got, Tensor) else f"a {type(got).__name__}"
            raise InterfaceError(f"estimator must return {name} {list(shape)} of one data set, got {shown}")
    return estimate


class Solution(NamedTuple):
    """Result of an estimator for b data sets in which the same readings exist.

    Attributes:
        theta: [b, 2].
        theta_covariance: [b, 2, 2].
        fading: [b] each.
        fading_covariance: covariance of the logarithms, [b, 3, 3].
        cost: negative log likelihood minus m/2 ln(2 pi), with m readings, [b].
        identifiable: which parameters of the fading the readings determine, bool [b, 3].
        evaluations: number of evaluations of the cost.
    """

    theta: Tensor
    theta_covariance: Tensor
    fading: Fading
    fading_covariance: Tensor
    cost: Tensor
    identifiable: Tensor
    evaluations: int


def _estimator(solve: Callable[[Tensor, Geometry], Solution]) -> Estimator:
    """An estimator made from a function of complete observations [b, S, N] and their geometry."""

    def estimate(readings: Readings, budget: LinkBudget) -> ChannelEstimate:
        rows, parts = [], []
        for group, y, geometry in observations(readings, budget):
            # The covariance matrices of all data sets of a chunk are in memory at the same time.
            chunk = max(1, MAX_ENTRIES // (geometry.spacing.numel() + geometry.apart.numel() + geometry.readings))
            rows.append(group)
            parts += [_channel_estimate(solve(part, geometry), budget) for part in y.split(chunk)]
        return ChannelEstimate.join(parts).select(torch.cat(rows).argsort())

    return estimate


def _channel_estimate(solution: Solution, budget: LinkBudget) -> ChannelEstimate:
    covariance = solution.theta.new_zeros(len(solution.theta), 5, 5)
    covariance[:, :2, :2], covariance[:, 2:, 2:] = solution.theta_covariance, solution.fading_covariance
    return ChannelEstimate(
        budget=budget,
        value=torch.cat([solution.theta, torch.stack(list(solution.fading), -1)], -1),
        covariance=covariance,
        identifiable=torch.cat([torch.ones_like(solution.identifiable[:, :2]), solution.identifiable], -1),
        cost=solution.cost,
        evaluations=solution.evaluations,
    )


def _residual(y: Tensor, H: Tensor, theta: Tensor) -> Tensor:
    return y - (H @ theta[:, None, :, None])[..., 0]


def _judged(y: Tensor, geometry: Geometry, theta: Tensor, covariance: Tensor, fading: Fading, rounds: int) -> Solution:
    """A solution with this theta and the fading fitted to its residuals; the covariance is the Cramer-Rao bound."""
    residual = _residual(y, geometry.H, theta)
    spectrum = Spectrum.of(geometry, fading.varphi)
    derivatives = Derivatives.of(geometry, spectrum, fading)
    W = derivatives.W
    cost = 0.5 * ((W * spectrum.rotate(residual).square()).sum((-2, -1)) - W.log().sum((-2, -1)))
    bound = torch.linalg.pinv(derivatives.information(), hermitian=True)
    profile = likelihood.profile(residual, geometry)
    _, spread = likelihood.averaged(profile, torch.zeros_like(theta), geometry.readings)
    return Solution(theta, covariance, fading, bound, cost, spread < SEPARABLE, rounds)


def _least_squares(y: Tensor, geometry: Geometry) -> Solution:
    theta = ordinary(y, geometry.H)
    fading = moment_fit(_residual(y, geometry.H, theta), geometry)
    # (H'H)^-1 H' Omega H (H'H)^-1: shadowing correlates readings, which then contain less information.
    spectrum = Spectrum.of(geometry, fading.varphi)
    H = spectrum.rotate_design(geometry.H).flatten(-3, -2)
    omega = fading.zeta2[:, None] * spectrum.eigenvalues.flatten(-2) + fading.rho2[:, None]
    inverse = torch.linalg.inv(H.mT @ H)
    covariance = inverse @ (H.mT @ (omega[..., None] * H)) @ inverse
    return _judged(y, geometry, theta, covariance, fading, 1)


def _refined(y: Tensor, geometry: Geometry, fading: Fading) -> tuple[Tensor, Tensor]:
    """theta [b, 2] from generalized least squares with this fading, and its covariance."""
    spectrum = Spectrum.of(geometry, fading.varphi)
    W = 1.0 / (fading.zeta2[:, None, None] * spectrum.eigenvalues + fading.rho2[:, None, None])
    theta, information, _ = model.generalized_least_squares(spectrum.rotate(y), spectrum.rotate_design(geometry.H), W)
    return theta, torch.linalg.inv(information)


def _alternating(y: Tensor, geometry: Geometry, rounds: int) -> Solution:
    """Alternate: fading from the moments of the residuals, then theta by generalized least squares with it."""
    theta = ordinary(y, geometry.H)
    fading = moment_fit(_residual(y, geometry.H, theta), geometry)
    before, (theta, covariance) = theta, _refined(y, geometry, fading)
    moving, spent = torch.arange(len(y), device=y.device), 1
    while spent < rounds:
        std = covariance[moving].diagonal(dim1=-2, dim2=-1).sqrt()
        moving = moving[((theta[moving] - before[moving]).abs() > SETTLED * std).any(-1)]
        if not len(moving):
            break
        before = theta.clone()
        renewed = moment_fit(_residual(y[moving], geometry.H, theta[moving]), geometry)
        theta[moving], covariance[moving] = _refined(y[moving], geometry, renewed)
        for old, new in zip(fading, renewed, strict=True):
            old[moving] = new
        spent += 1
    return _judged(y, geometry, theta, covariance, fading, spent)


def _maximum_likelihood(y: Tensor, geometry: Geometry) -> Solution:
    fit = likelihood.fit(y, geometry)
    fading = Fading(*fit.log_fading.exp().unbind(-1))
    bound = torch.linalg.pinv(fit.information, hermitian=True)
    identifiable = fit.spread < SEPARABLE
    return Solution(fit.theta, fit.theta_covariance, fading, bound, fit.cost, identifiable, fit.evaluations)


def _disk(y: Tensor, geometry: Geometry) -> Solution:
    theta = torch.stack([y.mean((-2, -1)), torch.zeros_like(y[:, 0, 0])], -1)
    power = (y - theta[:, :1, None]).square().sum((-2, -1)) / (geometry.readings - 1)
    covariance = torch.zeros_like(theta[..., None] * theta[:, None])
    covariance[:, 0, 0] = power / geometry.readings
    none, any_distance = torch.zeros_like(power), torch.ones_like(power)
    relative = torch.diag_embed(torch.stack([none, none, torch.full_like(none, 2.0 / (geometry.readings - 1))], -1))
    cost = 0.5 * (geometry.readings * power.log() + geometry.readings - 1)
    identifiable = torch.tensor([False, False, True], device=y.device).expand(len(y), 3)
    return Solution(theta, covariance, Fading(none, any_distance, power), relative, cost, identifiable, 1)


def disk(readings: Readings, budget: LinkBudget) -> ChannelEstimate:
    """The same SNR at every distance within hearing range: the disk model that the paper argues against."""
    estimate = _estimator(_disk)(readings, budget)
    estimate.identifiable[:, 1] = False
    return estimate


def oracle(readings: Readings, budget: LinkBudget, channel: Channel) -> ChannelEstimate:
    """The true channel, given as `channel`, for ablations; no other estimator has it."""
    truth = [channel.K_dB, channel.n, channel.zeta_dB**2, channel.varphi_m, channel.rho_dB**2]
    value = torch.tensor(truth, dtype=torch.float64, device=readings.snr.device).repeat(len(readings.snr), 1)
    nothing = torch.zeros_like(value[:, 0])
    return ChannelEstimate(budget, value, value.new_zeros(len(value), 5, 5), value > -torch.inf, nothing, 0)


# Ordinary least squares, then moments: [29].
least_squares = _estimator(_least_squares)
# One more step: theta is estimated again, with the fading from the moments.
generalized_least_squares = _estimator(lambda y, geometry: _alternating(y, geometry, 1))
# The three phases of [42], which the paper improves on: path loss, then fading, and both in turn until they settle.
separate = _estimator(lambda y, geometry: _alternating(y, geometry, ROUNDS))
maximum_likelihood = _estimator(_maximum_likelihood)

ESTIMATORS: dict[str, Estimator] = {
    "least_squares": least_squares,
    "generalized_least_squares": generalized_least_squares,
    "separate": separate,
    "maximum_likelihood": maximum_likelihood,
    "disk": disk,
}
