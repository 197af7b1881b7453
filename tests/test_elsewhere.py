"""Every part and whole commands on another device than the CPU: on one that is none, and on a GPU where there is one.

The numbers are the CPU's, to the last digit on the first and to 1e-6 on the second. `pytest -m cuda` runs the second.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any

import pytest
import torch
from elsewhere import DEVICE, Device, elsewhere
from torch import Tensor
from torch.utils._pytree import tree_map

from uwirl import build
from uwirl.config.make import make
from uwirl.irl.bellman import BellmanOperator, Segment
from uwirl.irl.solvers import Batch, Bounds
from uwirl.motion.learning import Learning
from uwirl.runs import run as runs
from uwirl.snr.diagnostics import diagnose
from uwirl.snr.estimators import maximum_likelihood, oracle
from uwirl.snr.integrated_kriging import IntegratedKriging
from uwirl.snr.kriging import Kriging
from uwirl.snr.links import Links
from uwirl.snr.outliers import reject_outliers
from uwirl.snr.posterior import FadingPosterior
from uwirl.study.snr_map import make_grid, make_map
from uwirl.world.readings import take_readings
from uwirl.world.truth import truth_of

QUIET = ("logging.figures=false", "logging.tensorboard=false", "logging.animation=false", "logging.progress=false")
BRIEF = (*QUIET, "scenario.duration_s=0.5")
ROOT = Path(__file__).parents[1]
ROUTE, MESSAGE = "motion/route_tracker.py", "world/relay.py"


def named(group: str) -> list[str]:
    """The choices of a group of settings."""
    return [path.stem for path in sorted((ROOT / "conf" / group).glob("*.yaml"))]


class There:
    """The other device.

    Args:
        stand_in: the one that is none; None for a GPU.
    """

    def __init__(self, stand_in: Device | None):
        self.stand_in, self.name = stand_in, "cuda" if stand_in is None else str(DEVICE)

    def sent(self, values: Any) -> Any:
        """The same with all tensors there."""
        return tree_map(lambda x: x.to(self.name) if isinstance(x, Tensor) else x, values)

    def same(self, found: Any, expected: Any) -> None:
        """Check that tensors from there are the CPU's."""
        tolerance = 1e-6 if self.stand_in is None else 0.0
        here = tree_map(lambda x: x.cpu() if isinstance(x, Tensor) else x, found)
        torch.testing.assert_close(here, expected, rtol=tolerance, atol=tolerance, equal_nan=True)

    def waiting_only_in(self, places: set[str]) -> AbstractContextManager[None]:
        """Check that the CPU waits for the device in these files of uwirl and nowhere else."""
        return _counted(self.stand_in, places) if self.stand_in is not None else _refused(allowed=bool(places))


@contextmanager
def _counted(device: Device, places: set[str]) -> Iterator[None]:
    device.waits.clear()
    yield
    assert {place.split()[1].split(":")[0] for place in device.waits} == places, device.waits


@contextmanager
def _refused(allowed: bool) -> Iterator[None]:
    torch.cuda.set_sync_debug_mode("default" if allowed else "error")
    try:
        yield
    finally:
        torch.cuda.set_sync_debug_mode("default")


@pytest.fixture(params=["none", pytest.param("cuda", marks=pytest.mark.cuda)])
def there(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[There]:
    if request.param == "cuda":
        if not torch.cuda.is_available():
            pytest.skip("no CUDA device that this PyTorch can use")
        with torch.no_grad():
            yield There(None)
        return
    load = torch.load

    def loaded(*args: Any, map_location: str = "cpu", **kwargs: Any) -> Any:
        content = load(*args, map_location="cpu", **kwargs)
        return tree_map(lambda x: x.to(map_location) if isinstance(x, Tensor) else x, content)

    monkeypatch.setattr(torch, "load", loaded)
    with torch.no_grad(), elsewhere() as device:
        yield There(device)


def test_the_stand_in_is_another_device():
    with elsewhere() as device:
        x = torch.arange(3.0, device=DEVICE)
        assert (x * torch.tensor(2.0) + x[torch.tensor([2, 1, 0])]).cpu().tolist() == [2.0, 3.0, 4.0]
        # Only the numbers and indices of the CPU were waited for, and the way back.
        assert all("_to_copy" in place for place in device.waits)
        here = torch.arange(3)
        for mixed in (lambda: x + here, lambda: here[x.long()], lambda: torch.stack([x, here])):
            with pytest.raises(RuntimeError, match=r"^expected all tensors on one device: "):
                mixed()
        with pytest.raises(TypeError, match=r"^can't convert lazy:0 device type tensor to numpy$"):
            x.numpy()
        for wait in (lambda: float(x[0]), lambda: x[x > 1.0], lambda: x.new_tensor([1.0]), lambda: x.tolist()):
            device.waits.clear()
            wait()
            assert sum(device.waits.values()) == 1


def test_arrays_are_of_any_device():
    """`numpy()` fails on tensors of a GPU, and on those alone."""
    sources = (ROOT / "uwirl").rglob("*.py")
    assert [path for path in sources if ".numpy()" in path.read_text()] == []


STEPS = {
    "free": (("experiment=fig5_free",), set()),
    "obstacles": (("experiment=fig5_single",), set()),
    "barrier": (("experiment=fig6_pair", "safety=barrier", "dtype=float32"), set()),
    "everything": (
        (
            "experiment=fig6_pair",
            "scenario.obstacles=[{center_m:[20.0,20.0],radius_m:2.0,influence_m:6.0}]",
            "scenario.navigation.position_m=0.1",
            "scenario.navigation.drift_mps=0.01",
            "scenario.current_mps=[0.1,0.0,0.0]",
            "scenario.current_std_mps=0.05",
        ),
        set(),
    ),
    # What is newly seen, and whether a message is sent, decides what is computed.
    "discovery": (("experiment=fig5_single", "scenario.detection_range_m=6.0"), {ROUTE}),
    "messages": (("experiment=fig5_free", "scenario.streaming=true"), {MESSAGE}),
}


@pytest.mark.parametrize(("overrides", "places"), STEPS.values(), ids=STEPS)
def test_a_control_step_waits_for_nothing(there: There, make_config, overrides: tuple[str, ...], places: set[str]):
    ends = []
    for name in ("cpu", there.name):
        config = make_config(*overrides)
        config.device = name
        env = build.make_relay(config)
        estimate = oracle(take_readings(env), env.budget, truth_of(env).channel)
        learning = Learning(build.make_planner(config, config.planner, env), env, estimate)
        weights = learning.basis.start_weights().repeat(learning.learners, 1).to(name)
        agent, guard = (
            learning.agent(weights, env.vehicle.trim.expand(learning.learners, 4)),
            build.make_guard(config, env),
        )
        state, observation = env.reset()
        carry = agent.init(observation)
        for k in range(2):
            checked = there.waiting_only_in(places) if k and name != "cpu" else None
            with checked or torch.no_grad():
                tau, carry = agent.act(carry, observation)
                state, observation = env.step(state, guard(tau, observation), getattr(carry, "target", None))
        ends.append((tau, state.components, observation.eta, observation.messages.snr))
    there.same(ends[1], ends[0])


@pytest.mark.parametrize("name", named("solver"))
def test_bellman_rows_and_solvers(there: There, make_config, name: str):
    generator = torch.Generator().manual_seed(1)
    drawn = [torch.randn(41, 2, n, generator=generator, dtype=torch.float64) for n in (3, 4, 2, 1)]
    R, weights = torch.tensor([0.3, 2.0], dtype=torch.float64), torch.zeros(2, 4, dtype=torch.float64)
    bounds = Bounds(torch.full((4,), -0.1, dtype=torch.float64), torch.full((4,), 0.2, dtype=torch.float64))

    def solved(values: Any) -> Any:
        (phi2, phi3, tau, q), R, weights, bounds = values
        operator = BellmanOperator(3, (2, 2), R)
        segment: Segment = operator.segment(phi2, phi3, tau[1:], q[..., 0].square(), 0.05, 4, 2)
        solver = make(make_config(f"solver={name}").solver, operator, Bounds(*bounds))
        return tuple(solver.solve(solver.add(solver.init(weights), Batch((segment,))), weights)[0][:2])

    given = drawn, R, weights, tuple(bounds)
    there.same(solved(there.sent(given)), solved(given))


def test_likelihood_diagnosis_and_map(there: There, make_config):
    found = []
    for name in ("cpu", there.name):
        config = make_config("channel=acoustic_24khz", "scenario.sensors=12")
        config.device = name
        env = build.make_relay(config)
        readings = reject_outliers(take_readings(env), env.budget)
        estimate = maximum_likelihood(readings, env.budget)
        posterior = FadingPosterior.coarse(Links.of(readings, env.budget))
        judged = diagnose(readings, posterior)
        grid, sender = make_grid(readings.receivers, -5.0, 8.0, 36), readings.transmitters[0]
        snr_map = make_map(IntegratedKriging(posterior.refined(), env.budget), grid, sender, None)
        exact = Kriging(readings, estimate.channel).mean(sender, grid.places)
        found.append((*estimate.parameter("K_dB")[:2], judged.standardized, judged.sensor.p, *snr_map[2:4], exact))
    there.same(found[1], found[0])


def flown(make_config, folder: Path, device: str, experiment: str, *overrides: str) -> dict[str, Any]:
    config = make_config(f"experiment={experiment}", *overrides)
    config.device = device
    folder.mkdir()
    return runs.run(config, experiment, folder)


def assert_same(there: There, found: dict[str, Any], expected: dict[str, Any]) -> None:
    """Entries of metrics.json; a converged optimum of another summation order may take other steps to it."""
    differ = {"wall_time_s", "config_hash", "checkpoint"}
    assert found.keys() == expected.keys()
    if there.stand_in is not None:
        assert {k: v for k, v in found.items() if k not in differ} == {k: expected[k] for k in expected.keys() - differ}
    for name in ("cost_total", "cost_total_median"):
        assert math.isclose(found.get(name) or 0.0, expected.get(name) or 0.0, rel_tol=1e-6)


LEARNED = (*BRIEF, "planner.max_time_s=12", "estimator=least_squares", "scenario.sensors=4")
FEW = ("scenario.layouts.count=3", "scenario.layouts.kinds=[overlapping,moving]", "estimator=oracle", "planner=pd")


def test_a_learned_mission_and_its_checkpoint(there: There, make_config, tmp_path: Path):
    here, away = (
        flown(make_config, tmp_path / name.split(":")[0], name, "fig5_free", *LEARNED) for name in ("cpu", there.name)
    )
    assert_same(there, away, here)
    # Each device flies what the other has learned.
    judged = []
    for device, learned_on in (("cpu", there.name), (there.name, "cpu")):
        config = make_config("experiment=fig5_free", *LEARNED)
        config.device = device
        folder = tmp_path / f"judged on {device[:4]}"
        folder.mkdir()
        path = tmp_path / learned_on.split(":")[0] / "checkpoints" / "last.pt"
        judged.append(runs.evaluate(config, "fig5_free", folder, path)["cost_total"])
    assert judged == pytest.approx([here["cost_total"]] * 2, rel=1e-6)


def test_random_layouts(there: There, make_config, tmp_path: Path):
    here, away = (
        flown(make_config, tmp_path / name.split(":")[0], name, "random_layouts", *BRIEF, *FEW)
        for name in ("cpu", there.name)
    )
    assert_same(there, away, here)


@pytest.mark.slow
@pytest.mark.parametrize("dtype", ["float64", "float32"])
@pytest.mark.parametrize("experiment", named("experiment"))
def test_every_experiment(there: There, make_config, tmp_path: Path, experiment: str, dtype: str):
    overrides = [*QUIET[1:], "scenario.duration_s=3", "planner.max_time_s=24", f"dtype={dtype}"]
    overrides += ["scenario.layouts.count=8"] if experiment == "random_layouts" else []
    here, away = (
        flown(make_config, tmp_path / name.split(":")[0], name, experiment, *overrides) for name in ("cpu", there.name)
    )
    assert_same(there, away, here)
