"""TensorBoard's event file, read back: scalars, text, image, mesh, and settings beside results in the same run."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imsave
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from tensorboard.plugins.hparams.plugin_data_pb2 import HParamsPluginData

from uwirl import build
from uwirl.snr.estimators import estimate_each_vehicle
from uwirl.study.evaluation import Evaluation
from uwirl.study.shadowing import LinksAtMessages, messages
from uwirl.study.tensorboard import TensorBoard

METRICS = {"cost_total": 3.25, "collisions": 0, "time_to_99_percent_s": None, "status": "complete"}


@pytest.fixture(scope="module")
def config(make_config):
    return make_config("planner=pd", "scenario.duration_s=5", "channel=acoustic_24khz")


@pytest.fixture(scope="module")
def mission(config) -> tuple[Evaluation, LinksAtMessages]:
    env = build.make_relay(config)
    _, estimate = estimate_each_vehicle(env, build.make_estimator(config.estimator))
    agent = build.make_planner(config, config.planner, env).fit(env, estimate)
    evaluation = build.make_evaluator(config, env).fly(agent)
    return evaluation, messages(env, evaluation.trajectory)


@pytest.fixture(scope="module")
def events(config, mission, tmp_path_factory: pytest.TempPathFactory) -> EventAccumulator:
    folder: Path = tmp_path_factory.mktemp("tb")
    picture = folder / "mission.png"
    imsave(picture, np.linspace(0.0, 1.0, 12).reshape(2, 2, 3))
    asked = ["channel.zeta_dB=3.0", "planner=pd", "logging.figures=false"]
    for place in (folder, None):
        with TensorBoard(place) as board:
            board.config(config)
            board.cost_per_iteration([5.0, 4.0])
            board.evaluation(*mission)
            board.picture(picture)
            board.compare("fig5_single", 7, asked, METRICS)
    assert len(list(folder.rglob("events.*"))) == 1
    return EventAccumulator(str(folder), size_guidance={"scalars": 0, "tensors": 0, "images": 0}).Reload()


def test_scalars(events: EventAccumulator, mission: tuple[Evaluation, LinksAtMessages]):
    evaluation, sent = mission
    capacity = events.Scalars("capacity/min_kbps")
    assert [event.step for event in capacity] == list(range(0, 5001, 500))
    assert [event.value for event in capacity] == pytest.approx(evaluation.chain_capacity[::10, 0].tolist(), rel=1e-6)
    shadowed = events.Scalars("capacity/min_shadowed_kbps")
    assert [event.value for event in shadowed] == pytest.approx(sent.link_capacity.amin(-1).tolist(), rel=1e-6)
    clearance = [event.value for event in events.Scalars("safety/min_clearance_m")]
    assert clearance == pytest.approx(evaluation.clearance[::10, 0, 0].tolist(), rel=1e-6)
    assert [event.value for event in events.Scalars("cost/total")] == [5.0, 4.0]
    assert events.Scalars("result/cost_total")[0].value == 3.25


def test_settings_stand_beside_results_in_the_same_run(events: EventAccumulator):
    start = HParamsPluginData.FromString(
        events.SummaryMetadata("_hparams_/session_start_info").plugin_data.content
    ).session_start_info.hparams
    assert start["seed"].number_value == 7.0
    assert start["channel.zeta_dB"].number_value == 3.0
    assert start["planner"].string_value == "pd"
    assert start["ablation"].string_value == "none"
    assert start["overrides"].string_value == "channel.zeta_dB=3.0 planner=pd"
    assert set(start) == {"channel.zeta_dB", "planner", "experiment", "ablation", "seed", "overrides"}
    experiment = HParamsPluginData.FromString(
        events.SummaryMetadata("_hparams_/experiment").plugin_data.content
    ).experiment
    named = {info.name.tag for info in experiment.metric_infos}
    assert named == {"result/cost_total", "result/collisions"}
    assert named <= set(events.Tags()["scalars"])


def test_text_image_and_mesh(events: EventAccumulator):
    assert events.Tags()["images"] == ["figures/mission"]
    assert (events.Images("figures/mission")[0].width, events.Images("figures/mission")[0].height) == (2, 2)
    text = events.Tensors("config/text_summary")[0].tensor_proto.string_val[0].decode()
    assert "zeta_dB: 3.0" in text
    vertices = events.Tensors("path_VERTEX")[0].tensor_proto
    assert [d.size for d in vertices.tensor_shape.dim] == [1, 101, 3]
