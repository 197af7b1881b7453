"""Report of `uwirl-estimate`: what it read, the channel, diagnostics, and a warning if something looks wrong."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from torch import Tensor

from uwirl.snr.diagnostics import Diagnostics
from uwirl.snr.estimate import NAMES, ChannelEstimate
from uwirl.snr.intervals import intervals
from uwirl.snr.posterior import FadingPosterior
from uwirl.study.survey import Survey

LABELS = ("K (dB)", "n", "zeta^2 (dB^2)", "varphi (m)", "rho^2 (dB^2)")
# Probability with which each check reports a correct log as wrong.
DOUBT = 0.001
# Probability with which any sensor of a log is accused if all are healthy.
FALSE_ALARM = 0.01
# Skewness and kurtosis need at least this many readings.
LEAST = 20
# Lines of readings that are not believed.
LISTED = 20


def introduction(survey: Survey, name: str) -> Iterator[str]:
    """Lines on what was read, and what of it counts.

    Args:
        survey: of the log.
        name: of the log.
    """
    counts, refused = survey.counts, survey.refused.tolist()
    kinds = ("readings", "dropouts", "messages", "sensors")
    yield f"{name}: " + ", ".join(f"{counts[kind]:,} {kind}" for kind in kinds)
    if survey.whole.unused:
        yield f"columns not used: {', '.join(survey.whole.unused)}"
    if refused:
        which = ", ".join(map(str, refused[:LISTED])) + (", ..." if len(refused) > LISTED else "")
        yield f"{len(refused):,} readings do not belong and are left out (estimator.robust), on line {which}"
    used = counts["readings_used"]
    if used + len(refused) < counts["readings"]:
        yield f"{used:,} readings are used, evenly over messages and sensors (max_readings={survey.most})"


def table(estimate: ChannelEstimate, posterior: FadingPosterior, readings: int) -> Iterator[str]:
    """Lines of a table of the parameters of one data set; where the fading is unidentifiable, how large it may be."""
    ends = intervals(estimate, readings)[0].tolist()
    possible = [*ends[:2], *posterior.intervals()[0].tolist()]
    yield f"{'parameter':<14} {'estimate':>14} {'std error':>10} {'95 % interval':>22}"
    for name, label, own, wide in zip(NAMES, LABELS, ends, possible, strict=True):
        value, std, identifiable = (x.item() for x in estimate.parameter(name))
        text, error = (f"{value:.4g}", f"{std:.2g}") if identifiable else ("unidentifiable", "")
        low, high = own if identifiable else wide
        yield f"{label:<14} {text:>14} {error:>10} {f'{low:.4g} .. {high:.4g}':>22}"


def open_metrics(posterior: FadingPosterior) -> dict[str, list[float]]:
    """Entries of metrics.json: between which values the fading lies with 95 %, identifiable or not."""
    ends = posterior.intervals()[0].tolist()
    return {f"estimate_{name}_possible": interval for name, interval in zip(NAMES[2:], ends, strict=True)}


def diagnostic_metrics(diagnostics: Diagnostics, line: Tensor, names: tuple[str, ...]) -> dict[str, Any]:
    """Entries of metrics.json.

    Args:
        diagnostics: of m readings.
        line: line of the file for each reading, [m].
        names: names of the sensors, [N].
    """
    reading, sensor = diagnostics.reading, diagnostics.sensor
    worst, farthest = reading.worst or 0, sensor.worst
    accused = diagnostics.accused(FALSE_ALARM)
    largest = int(diagnostics.standardized.abs().nan_to_num(0.0).argmax())
    return {
        "residual_largest": float(diagnostics.standardized[largest]),
        "residual_largest_line": int(line[largest]),
        "residual_rms": diagnostics.rms,
        "residual_beyond_3": diagnostics.beyond_3,
        "residual_worst": float(reading.standardized[worst]),
        "residual_worst_dB": float(reading.mean[worst]),
        "residual_worst_p": float(reading.p[worst]),
        "residual_worst_line": int(line[worst]),
        "residual_skewness": diagnostics.skewness,
        "residual_excess_kurtosis": diagnostics.excess_kurtosis,
        "residual_normality_p": diagnostics.normality_p,
        "links": diagnostics.links,
        "leave_one_out_rmse_dB": diagnostics.rmse_dB,
        "leave_one_out_rmse_path_loss_dB": diagnostics.path_loss_rmse_dB,
        "sensor_worst": None if farthest is None else names[farthest],
        "sensor_worst_mean_dB": None if farthest is None else float(sensor.mean[farthest]),
        "sensor_worst_standardized": None if farthest is None else float(sensor.standardized[farthest]),
        "sensor_worst_p": None if farthest is None else float(sensor.p[farthest]),
        "accused_sensors": [names[k] for k in accused],
        "accused_sensors_dB": [float(sensor.mean[k]) for k in accused],
    }


def diagnosis(metrics: dict[str, Any], readings: int) -> Iterator[str]:
    """Lines of text about the results of `diagnostic_metrics`."""
    kriged, loss = metrics["leave_one_out_rmse_dB"], metrics["leave_one_out_rmse_path_loss_dB"]
    yield f"each link predicted by the others: readings off by {kriged:.3g} dB rms, {loss:.3g} dB by path loss alone"
    moments = (
        f"; skewness {metrics['residual_skewness']:+.2f}, excess kurtosis {metrics['residual_excess_kurtosis']:+.2f}"
        if readings >= LEAST
        else ""
    )
    yield (
        f"in standard deviations: {metrics['residual_rms']:.3g} rms (1 if the model holds), "
        f"{100.0 * metrics['residual_beyond_3']:.3g} % beyond 3 (0.27), largest "
        f"{metrics['residual_largest']:+.2f} on line {metrics['residual_largest_line']}{moments}"
    )
    if metrics["sensor_worst"] is not None:
        yield (
            f"farthest off of the sensors: {metrics['sensor_worst']}, {metrics['sensor_worst_mean_dB']:+.3g} dB "
            f"({metrics['sensor_worst_standardized']:+.2f} standard deviations, shadowing included)"
        )


def suspicions(metrics: dict[str, Any], readings: int) -> Iterator[str]:
    """Sentences on what looks wrong in the results of `diagnostic_metrics`."""
    line, p = metrics["residual_worst_line"], metrics["residual_normality_p"]
    if readings * metrics["residual_worst_p"] < DOUBT:
        yield (
            f"line {line} does not belong: {metrics['residual_worst_dB']:+.1f} dB, {metrics['residual_worst']:+.1f} "
            "standard deviations; correct or remove it, or set estimator.robust=true"
        )
    for sensor, offset in zip(metrics["accused_sensors"], metrics["accused_sensors_dB"], strict=True):
        yield (
            f"sensor {sensor} does not agree with the others: {offset:+.1f} dB, more than its shadowing explains "
            f"(a false alarm in {FALSE_ALARM:.0%} of healthy logs); check its position, gain and noise"
        )
    if readings >= LEAST and p < DOUBT:
        yield f"residuals are not normal (p = {p:.1g}): intervals and outage are less sure than they look"
    rms = metrics["residual_rms"]
    # The root mean square of n independent normal numbers has standard deviation 1 / sqrt(2 n).
    if abs(rms - 1.0) > max(0.1, 4.0 / math.sqrt(2.0 * metrics["links"])):
        more = "more" if rms > 1.0 else "less"
        yield f"residuals scatter {more} than the fitted fading says: {rms:.2f} of its standard deviations"
