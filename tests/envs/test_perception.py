"""What vehicles are told: places, obstacles, readings and neighbours, each against its closed form."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import torch

from uwirl.envs import make_task
from uwirl.envs.features import FAR_M, LIMIT, SNR_DB
from uwirl.envs.task import RelayTask, TaskState
from uwirl.study.evaluation import Evaluator
from uwirl.world.random import RandomStreams
from uwirl.world.trajectory import WorldState
from uwirl.world.vehicle import VehicleState

NO_FADING = ["channel.zeta_dB=0", "channel.rho_dB=0"]
# From (-30, -30, -8) to (30, 30, -8).
HALF_SPAN = 30.0 * math.sqrt(2.0)


def begun(overrides: list[str], **options: int) -> tuple[RelayTask, Evaluator, TaskState]:
    task = make_task([*NO_FADING, *overrides], **options)
    judge = task.worlds(RandomStreams.worlds(0, 1))
    return task, judge, task.begin(judge)


def told(task: RelayTask, judge: Evaluator, state: TaskState, vehicle: int = 0) -> dict[str, float]:
    return dict(zip(task.features.names, task.observe(judge, state)[0, vehicle].tolist(), strict=True))


def test_place_and_velocity_are_seen_from_the_link():
    task, judge, state = begun(["experiment=fig5_free", "scenario.start=[[10,-10,-3,0.6]]"])
    x = state.world.components.clone()
    x[4:, 0, 0] = torch.tensor([1.0, -0.5, 0.2, 2.0])
    seen = told(task, judge, state._replace(world=state.world._replace(components=x)))
    # The link runs at 45 degrees: (10, -10) lies across it.
    expected = {"e_par": 0.0, "e_perp": -10.0 * math.sqrt(2.0) / HALF_SPAN, "e_z": 5.0 / 10.0}
    expected |= {"sin_yaw": math.sin(0.6 - math.pi / 4), "cos_yaw": math.cos(0.6 - math.pi / 4)}
    expected |= {"u": 0.5, "v": -0.25, "w": 0.1, "r": 0.5}
    assert {name: seen[name] for name in expected} == pytest.approx(expected, abs=1e-6)


def test_nearest_obstacles_come_first_in_body_axes():
    around = "[{center_m:[0,12],radius_m:1,influence_m:6},{center_m:[0,-6],radius_m:2,influence_m:6},"
    around += "{center_m:[0,60],radius_m:1,influence_m:6}]"
    # It looks along +y: the far one is ahead, the near one astern.
    overrides = ["scenario.start=[[0,0,-8,1.5707963267948966]]", f"scenario.obstacles={around}"]
    seen = told(*begun(overrides, nearest_obstacles=4))
    listed = [[seen[f"obstacle_{k}_{axis}"] for axis in ("x", "y", "clearance")] for k in (1, 2, 3, 4)]
    near, far = [-6.0 / FAR_M, 0.0, 3.7 / FAR_M], [12.0 / FAR_M, 0.0, 10.7 / FAR_M]
    np.testing.assert_allclose(listed, [near, far, [0.0, 0.0, 1.0], [0.0, 0.0, 1.0]], atol=1e-6)
    fewer = told(*begun(overrides, nearest_obstacles=1))
    assert [fewer[f"obstacle_1_{axis}"] for axis in ("x", "y", "clearance")] == pytest.approx(near, abs=1e-6)
    assert "obstacle_2_x" not in fewer


def test_obstacles_out_of_detection_range_are_not_seen_and_drifting_ones_are_seen_where_they_are():
    drifting = "scenario.obstacles=[{center_m:[15,0],radius_m:1,influence_m:6,velocity_mps:[-0.5,0]}]"
    overrides = ["scenario.start=[[0,0,-8,0]]", drifting, "scenario.detection_range_m=10"]
    task, judge, state = begun(overrides)
    assert told(task, judge, state)["obstacle_1_clearance"] == 1.0
    later = state.world._replace(step=torch.tensor([round(10.0 / task.scenario.dt)]))
    seen = told(task, judge, state._replace(world=later))
    assert seen["obstacle_1_x"] == pytest.approx(10.0 / FAR_M, abs=1e-6)
    assert seen["obstacle_1_clearance"] == pytest.approx(8.7 / FAR_M, abs=1e-6)


def test_links_read_the_mean_snr_where_nothing_fades():
    task, judge, state = begun(["scenario.start=[[0,10,-8,0]]"])
    l = np.array([math.hypot(30.0, 40.0), math.hypot(30.0, 20.0)])
    np.testing.assert_allclose(state.snr[0, 0], -60.0 - 50.0 * np.log10(l) + 160.0, rtol=1e-12)
    seen = told(task, judge, state)
    assert [seen["snr_previous"], seen["snr_next"]] == pytest.approx((state.snr[0, 0] / SNR_DB).tolist(), abs=1e-6)


def test_a_link_has_one_shadowing_and_a_multipath_for_each_reading():
    far = ["experiment=fig6_pair", "channel.zeta_dB=3"]
    worlds = RandomStreams.worlds(0, 150)
    silent = make_task([*far, "channel.rho_dB=0"])
    quiet = silent.begin(silent.worlds(worlds)).snr
    torch.testing.assert_close(quiet[:, 0, 1], quiet[:, 1, 0], rtol=0.0, atol=1e-12)
    assert 2.5 < float(quiet[:, 0, 0].std()) < 3.5
    loud_task = make_task([*far, "channel.rho_dB=2"])
    multipath = (loud_task.begin(loud_task.worlds(worlds)).snr - quiet).flatten(1)
    assert 1.85 < float(multipath.std()) < 2.15
    correlation = np.corrcoef(multipath.numpy().T) - np.eye(4)
    assert np.abs(correlation).max() < 0.3


def test_links_are_read_when_a_message_is_sent():
    task, judge, state = begun(["scenario.start=[[0,10,-8,0]]"], control_period_s=0.2)
    ahead, changed, sent = torch.tensor([[[0.3, 0.0, 0.0, 0.0]]], dtype=torch.float64), [], []
    for _ in range(10):
        after, _ = task.step(judge, state, ahead)
        changed.append(not torch.equal(after.snr, state.snr))
        sent.append(int(after.world.step) // 10 > int(state.world.step) // 10)
        if int(after.world.step) % 10 == 0:
            snr = judge.truth.link_snr_dB(after.world.vehicles.position)
            torch.testing.assert_close(after.snr[0, 0], snr[0])
        state = after
    # Messages every 0.5 s, control every 0.2 s.
    assert changed == sent
    assert sum(sent) == 4


def test_whoever_is_out_of_hearing_is_not_read():
    task, judge, state = begun(["experiment=fig5_free", "scenario.start=[[20,20,-8,0]]", "scenario.hearing_range_m=30"])
    assert state.snr[0, 0].isnan().tolist() == [True, False]
    assert told(task, judge, state)["snr_previous"] == -LIMIT


def test_neighbours_are_heard_in_body_axes_with_the_way_they_have_to_go():
    task, judge, state = begun(["experiment=fig6_pair", "scenario.start=[[0,0,-8,1.5707963267948966],[3,4,-7,0]]"])
    seen = told(task, judge, state)
    # Vehicle 0 looks along +y, and vehicle 1 is to reach (10, 10, -8).
    expected = {"next_x": 4.0, "next_y": -3.0, "next_z": 1.0, "next_x_to_go": 6.0, "next_y_to_go": -7.0}
    expected |= {"next_z_to_go": -1.0}
    assert {name: HALF_SPAN * seen[name] for name in expected} == pytest.approx(expected, abs=1e-5)
    assert seen["next_heard"] == 1.0
    assert [value for name, value in seen.items() if name.startswith("previous")] == [0.0] * 7
    assert told(task, judge, state, vehicle=1)["previous_heard"] == 1.0
    deaf = begun(["experiment=fig6_pair", "scenario.hearing_range_m=1"])
    assert [value for name, value in told(*deaf).items() if name.startswith("next")] == [0.0] * 7


def test_turning_the_world_changes_no_entry():
    """Nodes, obstacle and vehicle turned by an angle about the z axis."""

    def seen(angle: float) -> np.ndarray:
        def turned(x: float, y: float) -> str:
            c, s = math.cos(angle), math.sin(angle)
            return f"{c * x - s * y:.12f},{s * x + c * y:.12f}"

        overrides = [f"scenario.source_m=[{turned(-30, -20)},-8]", f"scenario.destination_m=[{turned(30, 25)},-8]"]
        overrides += [f"scenario.start=[[{turned(12, -5)},-4,{0.7 + angle:.12f}]]"]
        overrides += [f"scenario.obstacles=[{{center_m:[{turned(16, -9)}],radius_m:1,influence_m:5}}]"]
        task, judge, state = begun(overrides)
        return task.observe(judge, state).numpy()

    np.testing.assert_allclose(seen(1.1), seen(0.0), atol=1e-6)


def test_entries_stay_within_their_bounds():
    task, judge, state = begun(["experiment=fig6_pair"])
    wild = VehicleState.from_eta_nu(torch.full((1, 2, 4), 1e6).double(), torch.full((1, 2, 4), -1e6).double())
    world = WorldState.of(wild)._replace(target=state.world.target)
    observation = task.observe(judge, state._replace(world=world))
    assert float(observation.abs().max()) == LIMIT
    assert observation.dtype == torch.float32


def test_the_document_names_every_entry():
    text = (Path(__file__).parents[2] / "docs" / "environments.md").read_text(encoding="utf-8")
    for name in make_task(["experiment=fig6_pair"]).features.names:
        common = name.replace("next_", "previous_") if name.startswith("next_") else name
        common = "obstacle_k_" + name.split("_", 2)[2] if name.startswith("obstacle_") else common
        assert f"`{common}`" in text
