"""Stage 1 beside scikit-learn and GPyTorch, side by side in one run, on one thread.

    pip install 'uwirl[compare]'
    python benchmarks/estimation.py

Ratios are ours to the peer's, of processor times of calls in turn: the median, and the least and largest of them.

map      mean and standard deviation of the SNR at 3,500 points from N readings whose fading is known
fit      maximum likelihood of theta and fading; the peer is scikit-learn's GaussianProcessRegressor with one start from
         the data's variance and a tenth of their extent, on the residuals of ordinary least squares, for it has no
         trend. Ours searches globally. "worse by" is by how much the peer's likelihood ends below ours, in log
many     1,000 data sets of 16 readings, against a loop over the peer (of which 20 are timed)
"""

from __future__ import annotations

import statistics
import time
import warnings
from collections.abc import Callable
from typing import Any

import gpytorch
import torch
from sklearn.exceptions import ConvergenceWarning
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import ConstantKernel, Matern, WhiteKernel
from threadpoolctl import threadpool_limits
from torch import Tensor

from uwirl import build
from uwirl.config.compose import compose
from uwirl.snr.estimators import maximum_likelihood
from uwirl.snr.kriging import Kriging
from uwirl.snr.likelihood import ordinary
from uwirl.snr.model import observations
from uwirl.world.acoustics import Channel
from uwirl.world.fading import exact_shadowing
from uwirl.world.random import RandomStreams, Stream
from uwirl.world.readings import Readings
from uwirl.world.scenario import spread_sensors

POINTS = 70, 50
DATA_SETS, LOOPED = 1000, 20
NODES = [-30.0, -30.0, -8.0], [30.0, 30.0, -8.0]
START = torch.tensor([[29.5, 29.5, 0.0]], dtype=torch.float64)


def seconds(call: Callable[[], object]) -> float:
    """Processor time of a call."""
    begin = time.process_time()
    call()
    return time.process_time() - begin


def ratios(ours: Callable[[], object], peer: Callable[[], object], rounds: int, scale: float = 1.0) -> str:
    """Time of ours over that of the peer, which does 1 / scale of the work."""
    ours(), peer()
    pairs = [(seconds(ours), scale * seconds(peer)) for _ in range(rounds)]
    values = [a / b for a, b in pairs]
    a, b = (1e3 * statistics.median(times) for times in zip(*pairs, strict=True))
    return f"{statistics.median(values):>7.3f} [{min(values):.3f}, {max(values):.3f}] {a:>10.1f} {b:>10.1f}"


def read(channel: Channel, N: int, data_sets: int) -> Readings:
    """Of one message at the paper's start."""
    sensors = spread_sensors(N, 0, *NODES, torch.float64)
    streams = RandomStreams.worlds(N, data_sets)
    white = streams.normal(Stream.CHANNEL, 0, N)[:, None]
    multipath = streams.normal(Stream.MEASUREMENT, 0, N)[:, None]
    shadowing = exact_shadowing(START, sensors, float(channel.zeta_dB), float(channel.varphi_m), white)
    mean = channel.mean_snr_dB(torch.linalg.vector_norm(sensors - START, dim=-1))
    return Readings(START, sensors, mean + shadowing + channel.rho_dB * multipath)


def residuals(readings: Readings, channel: Channel) -> Tensor:
    """Of ordinary least squares, [B, N], dB."""
    _, y, geometry = next(observations(readings, channel.budget))
    return (y - (geometry.H @ ordinary(y, geometry.H)[:, None, :, None])[..., 0])[:, 0]


def sklearn_map(channel: Channel, readings: Readings, residual: Tensor, points: Tensor) -> Callable[[], object]:
    """scikit-learn's mean and deviation."""
    kernel = ConstantKernel(channel.zeta_dB**2, "fixed") * Matern(channel.varphi_m, "fixed", nu=0.5)
    kernel = kernel + WhiteKernel(channel.rho_dB**2, "fixed")
    X, y, Q = readings.receivers.numpy(), residual.numpy(), points.numpy()
    return lambda: GaussianProcessRegressor(kernel, optimizer=None, alpha=0.0).fit(X, y).predict(Q, return_std=True)


class _Process(gpytorch.models.ExactGP):
    def __init__(self, X: Tensor, y: Tensor, likelihood: Any):
        super().__init__(X, y, likelihood)
        self.mean = gpytorch.means.ZeroMean()
        self.kernel = gpytorch.kernels.ScaleKernel(gpytorch.kernels.MaternKernel(nu=0.5))

    def forward(self, X: Tensor) -> Any:
        return gpytorch.distributions.MultivariateNormal(self.mean(X), self.kernel(X))


def gpytorch_map(channel: Channel, readings: Readings, residual: Tensor, points: Tensor) -> Callable[[], object]:
    """GPyTorch's mean and deviation, by Cholesky."""

    def call() -> object:
        noise = gpytorch.constraints.GreaterThan(1e-8)
        likelihood = gpytorch.likelihoods.GaussianLikelihood(noise_constraint=noise).double()
        process = _Process(readings.receivers, residual, likelihood).double()
        likelihood.noise = channel.rho_dB**2
        process.kernel.outputscale = channel.zeta_dB**2
        process.kernel.base_kernel.lengthscale = channel.varphi_m
        process.eval()
        settings = gpytorch.settings
        with torch.no_grad(), settings.max_cholesky_size(5000), settings.fast_pred_var(False):
            latent = process(points)
            return latent.mean, latent.variance.sqrt()

    return call


def sklearn_fit(X: Tensor, residual: Tensor, extent: float) -> GaussianProcessRegressor:
    """One start, from what the data show at a glance."""
    variance = float(residual.var())
    kernel = ConstantKernel(variance) * Matern(extent / 10.0, nu=0.5) + WhiteKernel(variance)
    return GaussianProcessRegressor(kernel, alpha=0.0).fit(X.numpy(), residual.numpy())


def maps(channel: Channel) -> None:
    """Print the rows of maps."""
    axes = (torch.linspace(-30.0, 30.0, count, dtype=torch.float64) for count in POINTS)
    points = torch.nn.functional.pad(torch.cartesian_prod(*axes), (0, 1), value=-8.0)
    for N in (64, 256, 1000):
        readings = read(channel, N, 1)
        residual = residuals(readings, channel)[0]

        def ours(readings: Readings = readings) -> object:
            return Kriging(readings, channel).predict(START[0], points)

        rounds = 15 if N < 1000 else 5
        for name, peer in (("scikit-learn", sklearn_map), ("GPyTorch", gpytorch_map)):
            row = ratios(ours, peer(channel, readings, residual, points), rounds)
            print(f"{f'map, N = {N}':<34} {name:<13} {row}", flush=True)


def fits(name: str, channel: Channel) -> None:
    """Print the rows of fits."""
    for N in (16, 64, 256):
        readings = read(channel, N, 6)
        residual = residuals(readings, channel)
        extent = float(torch.pdist(readings.receivers).max())
        rows, worse = [], []
        for b in range(len(residual)):
            one = readings.select(slice(b, b + 1))
            rows.append(one)
            peer = sklearn_fit(readings.receivers, residual[b], extent).log_marginal_likelihood_value_
            constant = 0.5 * N * torch.log(torch.tensor(2.0 * torch.pi)).item()
            worse.append(-float(maximum_likelihood(one, channel.budget).cost[0]) - constant - peer)

        def ours(rows: list[Readings] = rows) -> object:
            return [maximum_likelihood(one, channel.budget) for one in rows]

        def theirs(residual: Tensor = residual, X: Tensor = readings.receivers, extent: float = extent) -> object:
            return [sklearn_fit(X, one, extent) for one in residual]

        row = ratios(ours, theirs, 3)
        note = f"worse by {min(worse):.3f} to {max(worse):.3f}"
        print(f"{f'fit, {name}, N = {N} (six)':<34} {'scikit-learn':<13} {row}   {note}", flush=True)
    readings = read(channel, 16, DATA_SETS)
    residual = residuals(readings, channel)
    extent = float(torch.pdist(readings.receivers).max())
    row = ratios(
        lambda: maximum_likelihood(readings, channel.budget),
        lambda: [sklearn_fit(readings.receivers, one, extent) for one in residual[:LOOPED]],
        3,
        DATA_SETS / LOOPED,
    )
    print(f"{f'many, {name}, N = 16':<34} {'scikit-learn':<13} {row}", flush=True)


@torch.no_grad()
def main() -> None:
    """Print the table."""
    torch.set_num_threads(1)
    warnings.simplefilter("ignore", ConvergenceWarning)
    print(f"{'':<34} {'peer':<13} {'ratio [least, largest]':>24} {'ours, ms':>8} {'peer, ms':>10}")
    with threadpool_limits(1):
        maps(build.make_channel(compose(["channel=acoustic_24khz"]).channel))
        for name in ("paper", "acoustic_24khz"):
            fits(name, build.make_channel(compose([f"channel={name}"]).channel))


if __name__ == "__main__":
    main()
