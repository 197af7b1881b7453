"""The law along routes: closed forms of speeds and forces, the value that it promises, headings, what it is worth."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from uwirl import build
from uwirl.irl.networks import LinearActor
from uwirl.motion.cruise import Cruise, declared_model
from uwirl.motion.guidance import GeodesicAgent
from uwirl.motion.linear_agent import LinkController
from uwirl.motion.link_frame import LinkFrame
from uwirl.motion.vehicle_model import Fossen, VehicleModel
from uwirl.motion.way_law import OnWay
from uwirl.world.obstacles import contacts
from uwirl.world.vehicle import VehicleState

DT, MASS, Q = 0.05, 20.0, 0.04
BEARING = math.pi / 4.0


def drags(linear: float, quadratic: float, across: float = 1.0) -> VehicleModel:
    """Drag in the plane, `across` times as large in sway; no Munk moment."""
    damping = [linear, across * linear, 5.0, 0.1, quadratic, across * quadratic, 30.0, 1.0]
    theta = torch.tensor([[MASS, MASS, MASS, 0.3, *damping, 0.0]], dtype=torch.float64)
    return VehicleModel(Fossen(), theta, theta.new_zeros(1, 2))


@pytest.fixture
def cruise(make_mission):
    """cruise(model): its law in free water, without a yaw term, and a controller that tells its trim."""
    mission = make_mission("experiment=fig5_free", "cost.yaw_weight=0")

    def make(model: VehicleModel) -> tuple[Cruise, LinkController]:
        tau_max = mission.env.vehicle.tau_max
        frame = LinkFrame(mission.targets.frame.target, mission.targets.frame.bearing)
        return Cruise(model, mission.cost, tau_max, DT), LinkController(frame, None, torch.zeros(1, 4).double())

    return make


def seen(speed: float | Tensor, heading: float = BEARING, way: float = BEARING, q: float = Q) -> OnWay:
    """A vehicle far from its goal and as deep, that goes along its route."""
    speed = torch.as_tensor(speed, dtype=torch.float64).reshape(1)
    off = torch.tensor(way - heading)
    eta = torch.tensor([[[-20.0, -20.0, -8.0, heading]]]).double()
    nu = torch.stack([speed * torch.cos(off), speed * torch.sin(off), 0.0 * speed, 0.0 * speed], -1)[None]
    one = torch.ones(1, 1, dtype=torch.float64)
    direction = torch.tensor([[[math.cos(way), math.sin(way)]]]).double()
    goal = torch.tensor([[[0.0, 0.0, -8.0]]]).double()
    state = VehicleState.from_eta_nu(eta, nu)
    return OnWay(state, direction, goal, 28.0 * one, BEARING * one, 0.0 * one, q * one)


@pytest.mark.parametrize(("linear", "quadratic", "k"), [(40.0, 0.0, 1.0), (0.0, 15.0, 1.0 / math.sqrt(3.0))])
def test_the_steady_force_is_that_of_the_drag(cruise, linear, quadratic, k):
    law, near = cruise(drags(linear, quadratic))
    F = k * math.sqrt(Q / float(law.cost.R[0]))
    speed = F / linear if linear else math.sqrt(F / quadratic)
    tau, slow = law.control(seen(speed), near)
    assert float(tau[0, 0, 0]) == pytest.approx(F, rel=0.03)
    assert float(slow) == pytest.approx(0.5 * speed, rel=0.03)


def test_at_rest_the_force_is_that_without_drag(cruise):
    for model in (drags(8.0, 0.0), drags(0.0, 15.0), drags(3.0, 20.0)):
        law, near = cruise(model)
        force = float(law.control(seen(0.0), near)[0][0, 0, 0])
        assert force == pytest.approx(math.sqrt(Q / float(law.cost.R[0])), rel=1e-6)


def test_what_a_flight_costs_is_the_value_of_its_law(cruise):
    """From rest, int q + R f^2 - h v dt = int 2 R m f dv over the speeds up to the best one."""
    law, near = cruise(drags(4.0, 18.0))
    R = float(law.cost.R[0])
    v, paid = 0.0, 0.0
    h = min((Q + R * (4.0 * x + 18.0 * x * x) ** 2) / x for x in torch.linspace(0.05, 2.0, 4000).tolist())
    for _ in range(400):
        f = float(law.control(seen(v), near)[0][0, 0, 0])
        paid += DT * (Q + R * f * f - h * v)
        v += DT * (f - 4.0 * v - 18.0 * v * v) / MASS
    speeds = torch.linspace(0.0, v, 400)
    forces = torch.stack([law.control(seen(x), near)[0][0, 0, 0] for x in speeds])
    value = float(torch.trapezoid(2.0 * R * MASS * forces, speeds))
    # Forces are held over a step, which loses 2 %.
    assert paid == pytest.approx(value, rel=0.05)


def test_a_vehicle_turns_into_its_route_if_that_is_cheaper(cruise):
    """Yaw moments at 60 degrees from the route: none if all headings cost the same."""
    # Thrust in sway costs 0.08 where it costs 0.1 in surge.
    alike, near = cruise(drags(40.0, 0.0, across=math.sqrt(0.1 / 0.08)))
    slender, _ = cruise(drags(4.0, 18.0, across=10.0))
    at = seen(0.5, heading=BEARING - math.pi / 3.0)
    assert abs(float(alike.control(at, near)[0][0, 0, 3])) < 0.1
    # Towards the route by the bow, which is nearer than the stern.
    assert float(slender.control(at, near)[0][0, 0, 3]) > 1.0


def test_the_munk_moment_is_cancelled(cruise):
    model = drags(4.0, 18.0, across=10.0)
    theta = model.theta.clone()
    theta[0, 1] = 2.0 * MASS
    at, moments = seen(1.0, heading=BEARING - 0.1), []
    for mass in (model.theta, theta):
        law, near = cruise(VehicleModel(model.regressor, mass, model.current))
        moments.append(float(law.control(at, near)[0][0, 0, 3]))
    u, v = at.state.nu[0, 0, :2].tolist()
    munk = (2.0 * MASS - MASS) * u * v
    # The heading is held more firmly too.
    assert munk < moments[1] - moments[0] < 2.0 * munk


@pytest.mark.parametrize("vehicle", ["low_drag", "asymmetric"])
def test_a_model_is_worth_more_than_a_quarter_of_what_is_declared(make_mission, make_config, vehicle):
    words = ("experiment=fig5_single", f"vehicle={vehicle}")
    mission, config = make_mission(*words), make_config(*words)
    env, own = mission.env, mission.env.vehicle
    theta = torch.cat([own.inertia, own.linear_damping, own.quadratic_damping, own.restoring[2:3]])
    truth = VehicleModel(Fossen(), theta[None], theta.new_zeros(1, 2))
    declared = declared_model(torch.tensor([12.0, 12.0, 12.0, 0.2]), own.tau_max)
    basis = build.make_planner(config, config.planner, env).basis(mission.cost)
    near = LinkController(mission.targets.frame, LinearActor(basis, basis.start_weights()[None]), own.trim[None])
    lead = build.make_guidance(config)(mission)
    flown = []
    for model in (truth, declared):
        agent = lead(near, model)
        assert isinstance(agent, GeodesicAgent)
        flown.append(build.make_evaluator(config, env).fly(agent))
    assert not any(bool(contacts(flight.clearance).any()) for flight in flown)
    assert bool(flown[0].arrival.isfinite().all())
    assert float(flown[1].cost) > 1.25 * float(flown[0].cost)
