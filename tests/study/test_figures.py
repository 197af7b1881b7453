"""Figures as a paper prints them: one size of type, true scale, letters once, lines that can be told apart."""

import os
import re
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from matplotlib.text import Text

from uwirl import build
from uwirl.motion.learning import IterationRecord
from uwirl.study import shadowing, style
from uwirl.study.colours import colours_of
from uwirl.study.learning_figure import held_values, learning_figure
from uwirl.study.mission_figures import mission_figure, motion_figure
from uwirl.world.agent import Feedback

SHORT = ("experiment=fig5_single", "scenario.duration_s=1")


@pytest.fixture
def mission(make_config, make_relay):
    """mission(overrides): the worlds, and vehicles in them that hold still for a second."""

    def fly(*overrides: str):
        env = make_relay(*SHORT, *overrides)
        resting = Feedback(lambda observation: env.vehicle.trim.expand_as(observation.eta))
        return env, build.make_evaluator(make_config(*SHORT, *overrides, "safety=none"), env).fly(resting)

    return fly


@pytest.fixture
def drawn(mission):
    """All figures of a run of two vehicles."""
    env, evaluation = mission("experiment=fig6_pair")
    basis = SimpleNamespace(critic_names=("u^2", "v^2"), actor_names=(("g", "u"), ("v",), ("w",), ("r",)))
    records = [
        IterationRecord(k, 20.0 * k, torch.full((1, 2), k), torch.full((1, 5), k), 0.1, False, 10, True)
        for k in (1, 2, 3)
    ]
    return [
        mission_figure(env.scenario, evaluation, shadowing.messages(env, evaluation.trajectory)),
        motion_figure(evaluation, env.vehicle.tau_max),
        learning_figure(records, [4.0, None, 3.0], {"pd": 3.3}, basis),
    ]


def test_one_size_of_type_and_a_papers_width(drawn):
    for figure in drawn:
        assert figure.get_figwidth() == style.PAGE
        figure.draw_without_rendering()
        sizes = {text.get_fontsize() for text in figure.findobj(Text) if text.get_text() and text.get_visible()}
        assert sizes <= {6.0, 7.0, 8.0}


def test_each_letter_stands_once_and_in_order(drawn):
    for figure in drawn:
        titles = [axes.get_title(loc="left") for axes in figure.axes]
        letters = [found[1] for title in titles if (found := re.match(r"\(([a-z])\) \w", title))]
        assert letters == [chr(ord("a") + k) for k in range(len(letters))]
        assert letters


@pytest.mark.parametrize("half_m", [30.0, 120.0])
def test_space_is_true_to_scale_or_says_how_far_it_is_not(mission, half_m):
    ends = [f"scenario.source_m=[-{half_m},-{half_m},-8]", f"scenario.destination_m=[{half_m},{half_m},-8]"]
    env, evaluation = mission("experiment=fig5_free", "planner=pd", *ends)
    figure = mission_figure(env.scenario, evaluation, shadowing.messages(env, evaluation.trajectory))
    space = figure.axes[0]
    spans = np.array([np.ptp(space.get_xlim()), np.ptp(space.get_ylim()), np.ptp(space.get_zlim())])
    stretch = np.array(space._box_aspect) / spans
    assert stretch[1] == pytest.approx(stretch[0], rel=1e-9)
    by = stretch[2] / stretch[0]
    # 8 m of depth are 0.13 of the sides of the smaller world, and 0.03 of the larger one's.
    assert by == pytest.approx(1.0 if half_m == 30.0 else 0.12 * 240.0 / 8.0, rel=1e-6)
    assert ("times" in space.get_zlabel()) == (half_m > 30.0)
    assert ("true to scale" in space.get_title(loc="left")) == (half_m == 30.0)


def test_png_and_pdf_from_one_figure(tmp_path, mission):
    _, evaluation = mission()
    style.save(motion_figure(evaluation, torch.ones(4)), tmp_path / "figures" / "motion.png")
    assert (tmp_path / "figures" / "motion.png").read_bytes().startswith(b"\x89PNG")
    assert (tmp_path / "figures" / "motion.pdf").read_bytes().startswith(b"%PDF")


def test_a_figure_that_cannot_be_written_leaves_nothing(tmp_path, monkeypatch):
    def full_disk(handle):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full_disk)
    with pytest.raises(OSError, match=r"No space left on device: '.*a\.png'$"):
        style.save(style.new(1.0, 1.0), tmp_path / "a.png")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("count", [1, 6, 7, 20])
def test_lines_have_colours_of_their_own(count):
    colours = colours_of(count)
    assert colours.shape == (count, 3)
    assert len({tuple(colour) for colour in colours}) == count
    assert (colours >= 0.0).all()
    assert (colours <= 1.0).all()


def test_what_was_known_at_a_time():
    values = held_values(np.array([0.0, 1.0, 2.5, 9.0]), np.array([1.0, 2.0]), np.array([5.0, 4.0]))
    np.testing.assert_array_equal(values, [np.nan, 5.0, 4.0, 4.0])
