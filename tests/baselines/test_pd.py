"""The baselines that anybody would try first: they arrive in free water, and a field pushes as its potential says."""

import pytest
import torch

from uwirl import build
from uwirl.baselines.potential_field import Repelled
from uwirl.snr.estimators import oracle
from uwirl.world.agent import Feedback
from uwirl.world.readings import take_readings
from uwirl.world.trajectory import WorldState
from uwirl.world.truth import truth_of
from uwirl.world.vehicle import VehicleState


@pytest.mark.parametrize("planner", ["pd", "potential_field"])
def test_flies_to_the_target_in_free_water(make_config, make_relay, planner):
    overrides = ("experiment=fig5_free", "scenario.duration_s=60", f"planner={planner}")
    config, env = make_config(*overrides), make_relay(*overrides)
    truth = oracle(take_readings(env), env.budget, truth_of(env).channel)
    evaluation = build.make_evaluator(config, env).fly(build.make_planner(config, config.planner, env).fit(env, truth))
    assert float(evaluation.chain_capacity[-1, 0]) > 0.99 * evaluation.optimal_capacity


def test_the_push_is_the_slope_of_the_potential(make_relay):
    """U_rep = eta / 2 sum (1/d - 1/d_0)^2 within d_0 of two cylinders; differentiated by place, turned by the yaw."""
    eta_N, reach, radius, psi = 10.0, 3.7, 0.3, 0.4
    cylinders = "{center_m:[2,1],radius_m:1,influence_m:3},{center_m:[-2,2],radius_m:0.5,influence_m:3}"
    env = make_relay(f"scenario.obstacles=[{cylinders},{{center_m:[9,0],radius_m:1,influence_m:3}}]")
    place = torch.zeros(1, 1, 4, dtype=torch.float64, requires_grad=True)
    d = env.scenario.obstacles.clearance(place[..., :3], radius)
    assert (d < reach).flatten().tolist() == [True, True, False]
    potential = 0.5 * eta_N * (1.0 / d - 1.0 / reach).clamp_min(0.0).square().sum()
    (slope,) = torch.autograd.grad(potential, place)
    pose = torch.tensor([[[0.0, 0.0, 0.0, psi]]], dtype=torch.float64)
    observation = env.observe(WorldState.of(VehicleState.from_eta_nu(pose)))
    idle = Feedback(lambda observation: torch.zeros_like(observation.eta))
    tau, _ = Repelled(idle, eta_N, reach, radius).act((), observation)
    x, y = -slope[0, 0, :2]
    c, s = torch.cos(torch.tensor(psi)), torch.sin(torch.tensor(psi))
    expected = torch.stack([c * x + s * y, -s * x + c * y, 0.0 * x, 0.0 * x])
    torch.testing.assert_close(tau[0, 0], expected, rtol=1e-6, atol=1e-9)
