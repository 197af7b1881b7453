"""Maximum likelihood against the dense Gaussian likelihood: its cost, its optimum, its bound and its profile."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from dense import Dense, geometry_of, simulate
from scipy import optimize
from torch import Tensor

from uwirl.snr import likelihood
from uwirl.snr.estimators import ESTIMATORS, maximum_likelihood
from uwirl.snr.information import Derivatives, cramer_rao_bound
from uwirl.snr.likelihood import DECREMENT, profile
from uwirl.snr.model import Fading, Spectrum, generalized_least_squares
from uwirl.world.acoustics import Channel
from uwirl.world.readings import Readings

SETS = 10
# Sensors and messages.
SIZES = [(16, 1), (12, 3)]
FITTING = ["least_squares", "generalized_least_squares", "separate", "maximum_likelihood"]


def fading_of(channel: Channel) -> tuple[float, float, float]:
    return channel.zeta_dB**2, channel.varphi_m, channel.rho_dB**2


def tensors(*values: float) -> Fading:
    return Fading(*torch.tensor(values, dtype=torch.float64))


def gapped(channel: Channel, sensors: int, messages: int) -> Readings:
    readings = simulate(channel, sensors, messages, SETS)
    readings.snr[:, -1, ::5] = torch.nan
    return readings


def residuals(readings: Readings, channel: Channel) -> Tensor:
    """Of ordinary least squares, [B, S, N]."""
    y, H = readings.snr + channel.budget.known_loss_dB(readings.distance), geometry_of(readings, channel).H
    return y - (H @ likelihood.ordinary(y, H)[:, None, :, None])[..., 0]


@pytest.mark.parametrize("gaps", [False, True])
@pytest.mark.parametrize(("sensors", "messages"), SIZES)
@pytest.mark.parametrize("name", FITTING)
def test_cost_is_the_dense_likelihoods(name: str, channel: Channel, sensors: int, messages: int, gaps: bool):
    readings = (gapped if gaps else simulate)(channel, sensors, messages)
    estimate = ESTIMATORS[name](readings, channel.budget)
    theta, fading = estimate.theta[0].numpy(), estimate.value[0, 2:].tolist()
    expected = Dense.of(readings, channel).cost(*fading, theta=theta)
    assert float(estimate.cost[0]) == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("gaps", [False, True])
@pytest.mark.parametrize(("sensors", "messages"), SIZES)
def test_nothing_is_likelier(channel: Channel, sensors: int, messages: int, gaps: bool):
    """Neither the truth nor what any other estimator says."""
    readings = gapped(channel, sensors, messages) if gaps else simulate(channel, sensors, messages, SETS)
    best = maximum_likelihood(readings, channel.budget).cost.tolist()
    others = [ESTIMATORS[name](readings, channel.budget) for name in FITTING]
    for row in range(SETS):
        dense = Dense.of(readings, channel, row)
        candidates = [dense.cost(*estimate.value[row, 2:].tolist()) for estimate in others]
        candidates.append(dense.cost(*fading_of(channel)))
        # Scoring stops half its decrement, to second order, short of the optimum.
        assert best[row] < min(candidates) + DECREMENT


def test_scipy_cannot_improve_on_it(acoustic: Channel):
    """From there, and within the bounds of the search."""
    readings = simulate(acoustic, 30, 3, SETS)
    estimate, residual = maximum_likelihood(readings, acoustic.budget), residuals(readings, acoustic)
    low, high = likelihood._bounds(profile(residual, geometry_of(readings, acoustic)), residual)
    inside = 0
    for row in range(SETS):
        dense, found = Dense.of(readings, acoustic, row), estimate.value[row, 2:].log()
        local = optimize.minimize(
            lambda x, dense=dense: dense.cost(*np.exp(x)),
            found.numpy(),
            method="L-BFGS-B",
            bounds=list(zip(low[row].tolist(), high[row].tolist(), strict=True)),
            options={"ftol": 1e-12, "gtol": 1e-6},
        )
        assert float(estimate.cost[row]) < local.fun + DECREMENT
        if bool(((low[row] < found) & (found < high[row])).all()):
            inside += 1
            errors = estimate.covariance[row, 2:, 2:].diagonal().sqrt()
            assert bool(((found - torch.from_numpy(local.x)).abs() < 3.0 * DECREMENT**0.5 * errors).all())
    assert inside >= SETS // 2


@pytest.mark.parametrize(("sensors", "messages"), SIZES)
def test_no_other_start_leads_higher(channel: Channel, sensors: int, messages: int):
    """Scored from a dozen places anywhere within the bounds; 0.05 is a likelihood 5 % larger."""
    sets = 50
    readings = simulate(channel, sensors, messages, sets, seed=3)
    residual, geometry = residuals(readings, channel), geometry_of(readings, channel)
    low, high = likelihood._bounds(profile(residual, geometry), residual)
    generator = torch.Generator().manual_seed(0)
    best = maximum_likelihood(readings, channel.budget).cost
    for _ in range(12):
        start = low + (high - low) * torch.rand(sets, 3, generator=generator, dtype=torch.float64)
        _, point, _ = likelihood.score(residual, geometry, start, low, high)
        assert float((best - point.cost).max()) < 0.05


@pytest.mark.parametrize(("sensors", "messages"), SIZES)
def test_gradient_and_information(acoustic: Channel, sensors: int, messages: int):
    """Derivatives of the dense cost, and tr(Omega^-1 Omega_a Omega^-1 Omega_b) / 2."""
    readings = simulate(acoustic, sensors, messages)
    geometry, dense = geometry_of(readings, acoustic), Dense.of(readings, acoustic)
    x, h = np.log([5.0, 9.0, 0.7]), 1e-5
    y = readings.snr + acoustic.budget.known_loss_dB(readings.distance)
    point = likelihood._evaluate(y, geometry, torch.from_numpy(x)[None])
    assert float(point.cost) == pytest.approx(dense.cost(*np.exp(x)), rel=1e-12)
    slope = [(dense.cost(*np.exp(x + h * e)) - dense.cost(*np.exp(x - h * e))) / (2.0 * h) for e in np.eye(3)]
    np.testing.assert_allclose(point.gradient[0], slope, rtol=1e-6, atol=1e-8)
    inverse = np.linalg.inv(dense.covariance(*np.exp(x)))
    whitened = [inverse @ derivative for derivative in dense.derivatives(*np.exp(x))]
    information = [[0.5 * np.trace(a @ b) for b in whitened] for a in whitened]
    np.testing.assert_allclose(point.information[0], information, rtol=1e-7)
    assert point.theta[0].tolist() == pytest.approx(dense.theta(*np.exp(x))[0], rel=1e-10)


@pytest.mark.parametrize(("sensors", "messages"), SIZES)
def test_forms_and_traces_of_the_derivatives(acoustic: Channel, sensors: int, messages: int):
    readings = simulate(acoustic, sensors, messages)
    geometry, dense, values = geometry_of(readings, acoustic), Dense.of(readings, acoustic), (5.0, 9.0, 0.7)
    spectrum = Spectrum.of(geometry, torch.tensor(values[1], dtype=torch.float64))
    derivatives = Derivatives.of(geometry, spectrum, tensors(*values))
    omegas, inverse = dense.derivatives(*values), np.linalg.inv(dense.covariance(*values))
    x = readings.snr[0]
    forms = [x.flatten().numpy() @ omega @ x.flatten().numpy() for omega in omegas]
    np.testing.assert_allclose(derivatives.quadratic_forms(spectrum.rotate(x)), forms, rtol=1e-7)
    np.testing.assert_allclose(derivatives.traces(), [np.trace(inverse @ omega) for omega in omegas], rtol=1e-7)


@pytest.mark.parametrize("messages", [1, 3])
def test_cramer_rao_bound(channel: Channel, messages: int):
    readings = simulate(channel, 14, messages)
    geometry, dense, values = geometry_of(readings, channel), Dense.of(readings, channel), fading_of(channel)
    bound = cramer_rao_bound(geometry, tensors(*values))
    inverse = np.linalg.inv(dense.covariance(*values))
    np.testing.assert_allclose(bound[:2, :2], np.linalg.inv(dense.H.T @ inverse @ dense.H), rtol=1e-8)
    whitened = [inverse @ derivative for derivative in dense.derivatives(*values)]
    information = [[0.5 * np.trace(a @ b) for b in whitened] for a in whitened]
    np.testing.assert_allclose(np.linalg.inv(bound[2:, 2:]), information, rtol=1e-5)
    assert not bool(bound[:2, 2:].any())
    assert torch.equal(bound, bound.mT) or torch.allclose(bound, bound.mT, rtol=1e-9)


def test_papers_fading_is_bounded_away_from_known(paper: Channel):
    """Relative standard errors of zeta^2 from one message: tens at 16 readings, units at 256."""
    few, many = (
        cramer_rao_bound(geometry_of(simulate(paper, n), paper), tensors(*fading_of(paper)))[2, 2].sqrt()
        for n in (16, 256)
    )
    assert 10.0 < float(few) < 300.0
    assert 1.0 < float(many) < 10.0


# Rows, correlation distances and ratios of the grid.
NODES = [(0, 1, 15), (1, 8, 24), (2, -1, 3)]


@pytest.mark.parametrize(("sensors", "messages"), SIZES)
def test_profile_is_the_concentrated_likelihood(acoustic: Channel, sensors: int, messages: int):
    """theta and the scale at their best for each correlation distance and ratio, in single precision."""
    readings = simulate(acoustic, sensors, messages, 3)
    residual = residuals(readings, acoustic)
    over_grid = profile(residual, geometry_of(readings, acoustic))
    for row, p, g in NODES:
        dense = replace(Dense.of(readings, acoustic, row), y=residual[row].flatten().numpy())
        varphi, ratio = float(over_grid.log_varphi[p].exp()), float(over_grid.log_ratio[g].exp())
        best = optimize.minimize_scalar(lambda s: dense.cost(ratio * np.exp(s), varphi, np.exp(s)))  # noqa: B023
        rho2 = float(over_grid.rho2[row, p, g])
        assert float(over_grid.cost[row, p, g]) == pytest.approx(best.fun, abs=1e-3)
        assert rho2 == pytest.approx(np.exp(best.x), rel=1e-4)
        theta, covariance = dense.theta(ratio * rho2, varphi, rho2)
        errors = np.sqrt(covariance.diagonal())
        assert (np.abs(over_grid.theta[row, p, g].numpy() - theta) < 1e-3 * errors).all()
        np.testing.assert_allclose(over_grid.inverse[p, g] * rho2, covariance, rtol=1e-3)


def test_restricted_likelihood_is_of_contrasts(acoustic: Channel):
    """Of m - 2 contrasts, which theta does not move; the scale at its best, up to a constant."""
    readings = simulate(acoustic, 12, 2, 3)
    residual = residuals(readings, acoustic)
    over_grid = profile(residual, geometry_of(readings, acoustic))
    dense = Dense.of(readings, acoustic)
    contrasts, m = np.linalg.svd(dense.H)[0][:, 2:], len(dense.y)
    for row in range(3):
        z, offsets = contrasts.T @ residual[row].flatten().numpy(), []
        for _, p, g in NODES:
            ratio, varphi = float(over_grid.log_ratio[g].exp()), float(over_grid.log_varphi[p].exp())
            omega = contrasts.T @ dense.covariance(ratio, varphi, 1.0) @ contrasts
            squares = z @ np.linalg.solve(omega, z)
            cost = 0.5 * (np.linalg.slogdet(omega)[1] + (m - 2) * np.log(squares))
            offsets.append(cost - float(over_grid.restricted[row, p, g]))
        assert np.ptp(offsets) < 1e-3


def test_generalized_least_squares_is_numpys(acoustic: Channel):
    readings = simulate(acoustic, 12, 3)
    geometry, fading = geometry_of(readings, acoustic), tensors(5.0, 9.0, 0.7)
    spectrum = Spectrum.of(geometry, fading.varphi)
    W = 1.0 / (fading.zeta2 * spectrum.eigenvalues + fading.rho2)
    y = readings.snr[0] + acoustic.budget.known_loss_dB(readings.distance)
    theta, information, residual = generalized_least_squares(spectrum.rotate(y), spectrum.rotate_design(geometry.H), W)
    dense = Dense.of(readings, acoustic)
    expected, covariance = dense.theta(5.0, 9.0, 0.7)
    assert theta.tolist() == pytest.approx(expected, rel=1e-10)
    np.testing.assert_allclose(information, np.linalg.inv(covariance), rtol=1e-8)
    back = spectrum.U @ residual @ spectrum.V.mT
    np.testing.assert_allclose(back.flatten(), dense.y - dense.H @ expected, atol=1e-9)


def test_scale_and_place_of_the_data_do_not_matter(acoustic: Channel):
    """Y -> 3 Y + H (20, 1): theta moves along, the powers grow ninefold, the correlation distance stays."""
    readings = simulate(acoustic, 20, 3, 3)
    known = acoustic.budget.known_loss_dB(readings.distance)
    offset = torch.tensor([20.0, 1.0], dtype=torch.float64)
    shift = geometry_of(readings, acoustic).H @ offset
    moved = replace(readings, snr=3.0 * (readings.snr + known) + shift - known)
    once, twice = maximum_likelihood(readings, acoustic.budget), maximum_likelihood(moved, acoustic.budget)
    torch.testing.assert_close(twice.theta, 3.0 * once.theta + offset, rtol=1e-6, atol=0.0)
    scale = torch.tensor([9.0, 1.0, 9.0], dtype=torch.float64)
    torch.testing.assert_close(twice.value[:, 2:], once.value[:, 2:] * scale, rtol=1e-4, atol=0.0)
    assert torch.equal(twice.identifiable, once.identifiable)
