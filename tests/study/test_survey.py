"""A log read without any settings: the channel behind it, what is not believed, and where a map can be."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from uwirl import LinkBudget, Survey
from uwirl.snr.log import LogError

SAMPLE = Path(__file__).parents[2] / "examples" / "readings.csv"
BUDGET = LinkBudget(N0_dB=-160.0, bandwidth_khz=10.0)


def test_each_diagnosis_stands_on_the_line_of_its_reading(tmp_path: Path):
    """The file in another order gives the same, line by line."""
    header, *rows = SAMPLE.read_text().splitlines()
    order = torch.randperm(len(rows), generator=torch.Generator().manual_seed(1)).tolist()
    path = tmp_path / "shuffled.csv"
    path.write_text("\n".join([header, *(rows[k] for k in order)]) + "\n")
    residuals = []
    for survey in (Survey.read(SAMPLE, BUDGET), Survey.read(path, BUDGET)):
        residual = survey.diagnose().residual
        residuals.append(dict(zip(survey.line.tolist(), residual.tolist(), strict=True)))
    straight, shuffled = residuals
    assert len(straight) == survey.counts["readings_used"]
    moved = {line: shuffled[order.index(line - 2) + 2] for line in straight}
    assert moved == pytest.approx(straight, abs=1e-4)


def test_a_reading_that_does_not_belong_is_refused_by_its_line(tmp_path: Path):
    lines = SAMPLE.read_text().splitlines()
    start, snr = lines[99].rsplit(",", 1)
    lines[99] = f"{start},{float(snr) + 60.0}"
    path = tmp_path / "wrong.csv"
    path.write_text("\n".join(lines) + "\n")
    survey = Survey.read(path, BUDGET, robust=True)
    assert 100 in survey.refused.tolist()
    assert 100 not in survey.line.tolist()
    assert survey.counts["readings_used"] + len(survey.refused) == survey.counts["readings"]
    assert len(Survey.read(path, BUDGET).refused) == 0


def test_a_map_goes_around_all_places_at_the_depth_of_its_sensors():
    survey = Survey.read(SAMPLE, BUDGET, most=100)
    grid, sender = survey.frame([200.0, 0.0, -3.0], spacing_m=10.0)
    assert sender.tolist() == [200.0, 0.0, -3.0]
    assert grid.z == pytest.approx(float(survey.whole.receivers[:, 2].mean()))
    assert grid.x[-1] > 200.0
    assert (grid.x[0] < survey.whole.receivers[:, 0].min(), grid.x.diff().unique().tolist()) == (True, [10.0])
    snr_map = survey.map(grid, sender, outage_kbps=12.0)
    assert snr_map.mean.shape == (len(grid.y), len(grid.x))
    assert snr_map.threshold == 12.0
    with pytest.raises(ValueError, match="500 m leaves fewer than 3 nodes"):
        survey.frame(spacing_m=500.0)


def test_a_log_that_determines_nothing_names_its_file(tmp_path: Path):
    path = tmp_path / "log.csv"
    path.write_text(SAMPLE.read_text().splitlines()[0] + "\n")
    with pytest.raises(LogError, match=r"log.csv: holds no rows"):
        Survey.read(path, BUDGET)
    with pytest.raises(LogError, match=r"readings.csv: 2 readings cannot determine"):
        Survey.read(SAMPLE, BUDGET, most=2)
