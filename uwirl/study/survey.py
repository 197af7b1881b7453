"""From a log of readings to the channel behind it, how far to trust it, and a map of the links that it lets expect."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import torch
from torch import Tensor

from uwirl.snr.diagnostics import Diagnostics, diagnose
from uwirl.snr.estimate import ChannelEstimate
from uwirl.snr.estimators import Estimator, maximum_likelihood
from uwirl.snr.integrated_kriging import IntegratedKriging
from uwirl.snr.links import Links
from uwirl.snr.log import Log, read_log
from uwirl.snr.log_file import LogError
from uwirl.snr.model import UnidentifiableError, observations
from uwirl.snr.outliers import reject_outliers
from uwirl.snr.plausibility import ImplausibleError, check_units, implausible
from uwirl.snr.posterior import FadingPosterior
from uwirl.study.snr_map import Grid, SnrMap, make_grid, make_map
from uwirl.world.acoustics import LinkBudget
from uwirl.world.readings import Readings


@dataclass(frozen=True)
class Survey:
    """A log that can be estimated from.

        survey = Survey.read("readings.csv", LinkBudget(N0_dB=-160.0, bandwidth_khz=10.0))
        estimate = survey.estimate()
        snr_map = survey.map(*survey.frame(spacing_m=2.0))

    Attributes:
        whole: the log.
        used: those of its readings that count, m.
        refused: lines of those that are not believed, int64 [k].
        budget: what is known of links beforehand.
        most: how many readings might have counted.
    """

    whole: Log
    used: Log
    refused: Tensor
    budget: LinkBudget
    most: int

    @classmethod
    def read(cls, path: Path | str, budget: LinkBudget, most: int = 1500, robust: bool = False) -> Survey:
        """Read a log, and choose the readings that count.

        Args:
            path: of a CSV file, see `uwirl.snr.log`.
            budget: what is known of links beforehand.
            most: readings that are used, evenly over the log; the time to estimate grows with their third power.
            robust: whether to leave out readings and sensors that do not belong, see `uwirl.snr.outliers`.

        Raises:
            LogError: the log cannot be used, its positions are degrees, or too few readings or distances are left to
                determine a channel.
            OSError: it cannot be opened.
        """
        path = Path(path)
        whole = read_log(path)
        used = whole.thinned(most)
        _check(path, used.readings, budget)
        refused = used.line[:0]
        if robust:
            believed = reject_outliers(used.readings, budget).snr[0][used.message, used.sensor]
            refused = used.line[believed.isnan()]
            used = replace(used, snr=believed).thinned(most)
            _check(path, used.readings, budget)
        return cls(whole, used, refused, budget, most)

    @property
    def line(self) -> Tensor:
        """Of the file, of each reading that counts, in the order of `diagnose`, int64 [m]."""
        return self.used.table(self.used.line, 0)[~self.used.readings.snr[0].isnan()]

    @property
    def counts(self) -> dict[str, int]:
        """Entries of metrics.json: how much was sent, read and used."""
        return {
            "messages": len(self.whole.transmitters),
            "sensors": len(set(self.whole.names)),
            "readings": self.whole.heard,
            "dropouts": len(self.whole.snr) - self.whole.heard,
            "readings_refused": len(self.refused),
            "readings_used": self.used.heard,
        }

    def estimate(self, estimator: Estimator = maximum_likelihood) -> ChannelEstimate:
        """The channel (9)-(13) behind the readings that count."""
        return estimator(self.used.readings, self.budget)

    def doubts(self, estimate: ChannelEstimate) -> list[str]:
        """Sentences on what cannot be true in the log, or in an estimate from it; empty if nothing looks wrong."""
        return [*self.whole.doubts, *implausible(self.used.readings, estimate)]

    @cached_property
    def posterior(self) -> FadingPosterior:
        """What the readings that count leave open about the fading."""
        return FadingPosterior.coarse(Links.of(self.used.readings, self.budget))

    def diagnose(self) -> Diagnostics:
        """Whether those readings look as the model says, each held against what the others predict, [m]."""
        return diagnose(self.used.readings, self.posterior)

    def frame(
        self, from_m: list[float] | None = None, z_m: float | None = None, spacing_m: float | None = None
    ) -> tuple[Grid, Tensor]:
        """Where a map can be: a grid around all that the log names, and where its links begin, [3], m.

        Args:
            from_m: [x, y, z], m, of the vehicle whose links are mapped; None for that of the last message.
            z_m: of the map, m; None for the sensors' mean.
            spacing_m: between nodes, m; None for about 3,500 of them.

        Raises:
            ValueError: fewer nodes than a map has, or more than there is time for.
        """
        transmitters, receivers = self.whole.transmitters, self.whole.receivers
        sender = transmitters[-1] if from_m is None else torch.tensor(from_m, dtype=torch.float64)
        places = torch.cat([transmitters, receivers, sender[None]])
        z = float(receivers[:, 2].mean()) if z_m is None else z_m
        return make_grid(places, z, spacing_m, self.used.heard), sender

    def map(self, grid: Grid, sender: Tensor, outage_kbps: float | None = None) -> SnrMap:
        """Expected SNR, its uncertainty, capacity and outage of links from one place, whatever the fading may be.

        Args:
            grid: where the links end.
            sender: where they begin, [3], m.
            outage_kbps: what counts as outage below it, kbit/s; None for half of the map's median capacity.
        """
        return make_map(IntegratedKriging(self.posterior.refined(), self.budget), grid, sender, outage_kbps)


def _check(path: Path, readings: Readings, budget: LinkBudget) -> None:
    try:
        check_units(readings, budget)
        next(observations(readings, budget))
    except (ImplausibleError, UnidentifiableError) as error:
        raise LogError(path, str(error)) from None
