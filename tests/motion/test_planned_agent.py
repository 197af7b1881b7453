"""Plans in a world that is not known beforehand: obstacles that are found, that drift, that block; other vehicles."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from uwirl import build
from uwirl.motion.identification import Identified
from uwirl.motion.identified_planner import IdentifiedPlanner, Learned
from uwirl.motion.planned_agent import PlanCarry
from uwirl.snr.estimators import estimate_each_vehicle
from uwirl.study.evaluation import Evaluation
from uwirl.world.geometry import to_inertial
from uwirl.world.obstacles import contacts
from uwirl.world.relay import Relay
from uwirl.world.truth import truth_of
from uwirl.world.vehicle import Vehicle

RING = (
    "scenario.obstacles=["
    + ",".join(
        f"{{center_m:[{4.0 * c:.3f},{4.0 * s:.3f}],radius_m:0.9,influence_m:3}}"
        for c, s in ((torch.cos(a).item(), torch.sin(a).item()) for a in torch.arange(16) * (torch.pi / 8.0))
    )
    + "]"
)
DRIFTING = "scenario.obstacles=[{center_m:[9,14],radius_m:2,influence_m:6,velocity_mps:[0.2,-0.2]}]"


@pytest.fixture(scope="module")
def learned() -> Learned:
    """The truth, as if it had been learned."""
    vehicle = Vehicle.bluerov2()
    parts = vehicle.inertia, vehicle.linear_damping, vehicle.quadratic_damping, vehicle.restoring[2:3]
    theta = torch.cat(parts).double()
    return Learned(Identified(theta, 1e-3 * theta.abs(), theta.new_zeros(2), theta.new_zeros(2)), vehicle.trim, 64.0, 0)


@pytest.fixture
def fly(learned, make_config, make_relay):
    """fly(overrides): the mission of the settings, and the agent's carry at its end."""

    def go(*overrides: str) -> tuple[Evaluation, PlanCarry]:
        words = ("experiment=fig5_single", "planner=identified", "planner.node_s=0.2", *overrides)
        config, env = make_config(*words), make_relay(*words)
        _, estimate = estimate_each_vehicle(env, build.make_estimator(config.estimator, env))
        planner = build.make_planner(config, config.planner, env)
        assert isinstance(planner, IdentifiedPlanner)
        evaluation = build.make_evaluator(config, env).fly(planner.agent(env, estimate, learned))
        return evaluation, evaluation.trajectory.carry

    return go


def test_obstacles_that_are_found_in_flight_are_planned_around(fly):
    flown, carry = fly("scenario.detection_range_m=8")
    assert not bool(contacts(flown.clearance).any())
    assert flown.time_to_99_percent() is not None
    assert bool(carry.flown.all())
    # The optimiser, which knows them from the start, needs 3.273.
    assert float(flown.cost) < 3.4


def test_drifting_obstacles_are_foreseen(fly):
    flown, _ = fly(DRIFTING, "scenario.duration_s=60")
    assert not bool(contacts(flown.clearance).any())
    assert flown.time_to_99_percent() is not None
    assert not bool(flown.intervened.any())


def test_a_blocked_target_is_left_to_the_law_along_the_way(fly):
    flown, carry = fly(RING, "scenario.duration_s=30")
    assert bool(flown.blocked.all())
    assert not bool(carry.flown.any())
    assert not bool(contacts(flown.clearance).any())


def test_vehicles_keep_apart(fly):
    flown, _ = fly("experiment=fig6_pair", "scenario.duration_s=70")
    assert float(flown.separation.min()) > 0.95
    assert flown.time_to_99_percent() is not None


class Odd(Vehicle):
    """Drag of exponent 1.8, and drag that couples sway and yaw: nothing that the model has."""

    def rk4(self, x: Tensor, tau: Tensor, dt: float, out: Tensor | None = None) -> Tensor:
        inertia, linear, quadratic, rest = (
            part.view(4, *[1] * (x.ndim - 1))
            for part in (self.inertia, self.linear_damping, self.quadratic_damping, self.restoring)
        )

        def rate(y: Tensor) -> Tensor:
            nu, (u, v, w, r) = y[4:], y[4:]
            force = tau - rest - linear * nu - quadratic * nu.abs() ** 0.8 * nu
            coriolis = inertia[1] * v * r, -inertia[0] * u * r - 3.0 * r, 0.0 * w, (inertia[0] - inertia[1]) * u * v - v
            return torch.cat([torch.stack([*to_inertial(u, v, y[3]), w, r]), (force + torch.stack(coriolis)) / inertia])

        first = rate(x)
        second = rate(x + 0.5 * dt * first)
        third = rate(x + 0.5 * dt * second)
        after = x + dt / 6.0 * (first + 2.0 * (second + third) + rate(x + dt * third))
        return after if out is None else out.copy_(after)


@pytest.mark.parametrize("vehicle", ["bluerov2", "low_drag"])
def test_a_vehicle_that_the_model_cannot_be_is_flown_all_the_same(make_config, make_relay, vehicle):
    words = ("experiment=fig5_single", "planner=identified", f"vehicle={vehicle}")
    config, plain = make_config(*words), make_relay(*words)
    env = Relay(plain.scenario, Odd(**config.vehicle.values()), truth_of(plain).channel, plain.streams)
    _, estimate = estimate_each_vehicle(env, build.make_estimator(config.estimator, env))
    planners = [build.make_planner(config, which, env) for which in (config.planner, config.baseline)]
    evaluator = build.make_evaluator(config, env)
    ours, pd = evaluator.fly_side_by_side([(planner.fit(env, estimate), 1) for planner in planners])
    assert not bool(contacts(ours.clearance).any())
    assert ours.time_to_99_percent() is not None
    assert float(ours.cost) < float(pd.cost)
