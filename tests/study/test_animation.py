"""GIFs of short missions of two vehicles that hold still among obstacles."""

import os
from dataclasses import replace

import pytest
import torch
from PIL import Image

from uwirl import build
from uwirl.study import animation
from uwirl.world.agent import Feedback
from uwirl.world.obstacles import Obstacles
from uwirl.world.random import RandomStreams

DRIFTING = "scenario.obstacles=[{center_m:[0,5],radius_m:2,influence_m:6,velocity_mps:[0.5,0]}]"
SHORT = ("scenario.start=[[-10,-10,-8,1],[10,10,-8,2]]", "scenario.duration_s=5")


@pytest.fixture
def mission(make_config, make_relay):
    """Scenario and evaluation of a batch of worlds."""

    def fly(*overrides: str, worlds: int = 1):
        env = make_relay(*SHORT, *overrides, streams=RandomStreams.worlds(0, worlds))
        resting = Feedback(lambda observation: env.vehicle.trim.expand_as(observation.eta))
        evaluator = build.make_evaluator(make_config(*SHORT, *overrides, "safety=none"), env)
        return env.scenario, evaluator.fly(resting)

    return fly


def test_frames_and_size(mission, tmp_path):
    """5 s at 8 times the speed and 10 frames a second."""
    path = tmp_path / "figures" / "mission.gif"
    animation.save(*mission(DRIFTING), path)
    with Image.open(path) as film:
        assert (film.format, film.n_frames, film.size) == ("GIF", 6, (680, 850))
        assert film.info["duration"] == 100
    assert path.stat().st_size < 200_000


def test_a_film_that_cannot_be_written_leaves_nothing(mission, tmp_path, monkeypatch):
    def full_disk(handle):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full_disk)
    with pytest.raises(OSError, match=r"No space left on device: '.*mission\.gif'$"):
        animation.save(*mission(), tmp_path / "mission.gif")
    assert list(tmp_path.iterdir()) == []


def test_slower_films_have_more_frames(mission, tmp_path):
    animation.save(*mission(), tmp_path / "slow.gif", fps=20, speed=4.0)
    with Image.open(tmp_path / "slow.gif") as film:
        assert (film.n_frames, film.info["duration"]) == (25, 50)


def test_obstacles_drift(mission, tmp_path):
    """The cylinder, gray, is 2.5 m further along x in the last frame."""
    animation.save(*mission(DRIFTING), tmp_path / "mission.gif")
    left = []
    with Image.open(tmp_path / "mission.gif") as film:
        for k in (0, film.n_frames - 1):
            film.seek(k)
            row = torch.tensor([film.convert("RGB").getpixel((x, 285)) for x in range(80, 590)])
            left.append(int((row - 127).abs().amax(1).le(4).nonzero().min()))
    metres_per_pixel = 1.12 * 60.0 / 517.0
    assert (left[1] - left[0]) * metres_per_pixel == pytest.approx(2.5, abs=0.3)


def test_world_of_a_batch_with_padded_obstacles(mission, tmp_path):
    """Worlds with obstacles of their own, one of them absent, look as if they were alone."""
    scenario, evaluation = mission(DRIFTING)
    animation.save(scenario, evaluation, tmp_path / "alone.gif")
    scenario, evaluation = mission(DRIFTING, worlds=2)
    one = scenario.obstacles
    fields = {
        "centre": torch.tensor([[[20.0, 0.0], [9.0, 9.0]], [[0.0, 5.0], [1e4, 1e4]]]),
        "radius": torch.tensor([[1.0, 1.0], [2.0, 0.0]]),
        "influence": torch.tensor([[3.0, 3.0], [6.0, 0.0]]),
        "velocity": one.velocity.expand(2, 2, 2),
        "present": torch.tensor([[True, True], [True, False]]),
    }
    animation.save(replace(scenario, obstacles=Obstacles(**fields)), evaluation, tmp_path / "batch.gif", world=1)
    assert (tmp_path / "batch.gif").read_bytes() == (tmp_path / "alone.gif").read_bytes()


@pytest.mark.parametrize("wrong", [{"fps": 0}, {"speed": -1.0}])
def test_speed_must_be_positive(mission, tmp_path, wrong):
    with pytest.raises(ValueError, match="fps and speed must be greater than 0, got"):
        animation.save(*mission(), tmp_path / "mission.gif", **wrong)
