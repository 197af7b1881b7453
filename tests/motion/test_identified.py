"""planner=identified from its parts to a flight: model, identification, cost of plans, plans, agent."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from uwirl import build
from uwirl.motion.flight_cost import FlightCost
from uwirl.motion.flight_plan import FlightProblem, optimise
from uwirl.motion.identification import Identified, Log, Windows, identify, identify_flights
from uwirl.motion.identified_planner import UnidentifiedError
from uwirl.motion.link_frame import LinkFrame
from uwirl.motion.mission import Mission
from uwirl.motion.vehicle_model import Fossen, VehicleModel
from uwirl.snr.estimators import estimate_each_vehicle
from uwirl.world.geometry import turned_to_body
from uwirl.world.obstacles import Obstacles, contacts
from uwirl.world.truth import truth_of
from uwirl.world.vehicle import Vehicle, VehicleState

NU = torch.tensor([[0.8, -0.3, 0.2, 0.5], [-1.2, 0.4, -0.1, -0.7]], dtype=torch.float64)


def true_theta(vehicle: Vehicle) -> torch.Tensor:
    parts = vehicle.inertia, vehicle.linear_damping, vehicle.quadratic_damping, vehicle.restoring[2:3]
    return torch.cat(parts).double()


@pytest.fixture
def model() -> VehicleModel:
    theta = true_theta(Vehicle.bluerov2()).expand(2, -1)
    return VehicleModel(Fossen(), theta, torch.tensor([[0.0, 0.0], [0.1, -0.2]], dtype=torch.float64))


def states() -> torch.Tensor:
    eta = torch.tensor([[1.0, 2.0, -3.0, 0.4], [-5.0, 1.0, -8.0, 2.5]], dtype=torch.float64)
    return torch.cat([eta, NU], -1)


def test_rate_is_that_of_the_vehicle_in_its_water(model: VehicleModel):
    """By a tiny step of the world's vehicle; nu is through the water there and here."""
    vehicle, x, dt = Vehicle.bluerov2(), states(), 1e-6
    effort = torch.tensor([[10.0, -5.0, 3.0, 1.0], [-20.0, 8.0, -4.0, 0.5]], dtype=torch.float64)
    torch.testing.assert_close(model.trim, vehicle.trim.expand(2, 4))
    moved = vehicle.rk4(x.T.contiguous(), (effort + vehicle.trim).T, dt).T
    expected = (moved - x) / dt
    expected[:, :2] += model.current
    torch.testing.assert_close(model.rate(x, effort), expected, rtol=1e-5, atol=1e-5)


def test_jacobian_is_autograds(model: VehicleModel):
    x, effort = states(), torch.zeros(2, 4, dtype=torch.float64)
    whole = torch.autograd.functional.jacobian(lambda y: model.rate(y, effort), x)
    torch.testing.assert_close(model.jacobian(x), torch.stack([whole[k, :, k] for k in range(2)]))


def flown(noise: float, seed: int, seconds: float = 60.0) -> Log:
    """A free flight under a multisine."""
    vehicle, draw, dt = Vehicle.bluerov2(), torch.Generator().manual_seed(seed), 0.05
    steps = round(seconds / dt)
    time = dt * torch.arange(steps, dtype=torch.float64)
    omega = 0.2 + 4.0 * torch.rand(6, 4, generator=draw, dtype=torch.float64)
    phase = 6.3 * torch.rand(6, 4, generator=draw, dtype=torch.float64)
    wave = torch.sin(omega * time[:, None, None] + phase).sum(1) * torch.tensor([18.0, 18.0, 9.0, 1.5]).double()
    tau = wave + vehicle.trim
    x = torch.zeros(8, 1, 1, dtype=torch.float64)
    x[2] = -10.0
    flight = [x]
    for k in range(steps):
        flight.append(vehicle.step(VehicleState(flight[-1]), tau[k, None, None], dt).components)
    components = torch.stack(flight)[..., 0].transpose(1, 2)
    nu = components[..., 4:] + noise * torch.randn(steps + 1, 1, 4, generator=draw, dtype=torch.float64)
    return Log(components[..., :4], nu, tau[:, None])


def found(*log: object) -> Identified:
    vehicle = Vehicle.bluerov2()
    identified = identify_flights(
        Windows(Fossen(), 0.05, 20, 20, 1e3), [flown(*log)], vehicle.tau_max, torch.zeros(2).double()
    )
    assert identified is not None
    return identified


def test_parameters_are_found_from_a_minute_of_flight():
    truth, theta = true_theta(Vehicle.bluerov2()), found(0.0, 0).theta
    torch.testing.assert_close(theta[:4], truth[:4], rtol=0.02, atol=0.0)
    drag = [some[4:8] * 0.5 + some[8:12] * 0.25 for some in (theta, truth)]
    torch.testing.assert_close(drag[0], drag[1], rtol=0.02, atol=0.0)
    assert float(theta[12]) == pytest.approx(-2.0, abs=0.02)


def test_errors_are_within_three_standard_errors():
    """Of 20 noisy flights, all 13 parameters: 99 % would leave three of 260 outside, and 7 with probability 0.02."""
    truth = true_theta(Vehicle.bluerov2())
    outside = 0
    for seed in range(20):
        known = found(0.01, seed)
        outside += int(((known.theta - truth).abs() > 3.0 * known.std).sum())
    assert outside <= 6


def test_a_current_is_found_with_the_parameters():
    """nu is over ground; the vehicle moves through the water."""
    current, still = torch.tensor([0.2, -0.1]).double(), flown(0.0, 1)
    velocity = torch.nn.functional.pad(current, (0, 2)).expand_as(still.nu)
    drifted = still._replace(nu=still.nu + turned_to_body(velocity, still.eta[..., 3]))
    windows, scale = Windows(Fossen(), 0.05, 20, 20, 1e3), Vehicle.bluerov2().tau_max
    known = identify_flights(windows, [drifted], scale, torch.zeros(2).double())
    assert known is not None
    torch.testing.assert_close(known.current, current, rtol=0.0, atol=0.005)
    torch.testing.assert_close(known.theta[:4], true_theta(Vehicle.bluerov2())[:4], rtol=0.02, atol=0.0)


def test_too_short_a_flight_is_refused():
    windows, log, scale = Windows(Fossen(), 0.05, 20, 20, 1e3), flown(0.0, 0, 5.0), Vehicle.bluerov2().tau_max
    assert identify_flights(windows, [log], scale, torch.zeros(2).double()) is None
    with pytest.raises(ValueError, match="5 windows of flight for 13 parameters"):
        identify(windows.rows(*log), Fossen(), scale)


@pytest.fixture
def cost(make_relay) -> FlightCost:
    """Two flights near two obstacles, one of which drifts; one guard acts on both."""
    env = make_relay("experiment=fig5_single")
    mission = Mission(env, truth_of(env).channel)
    rows = torch.zeros(2, dtype=torch.long)
    frame = mission.targets.frame
    place = torch.tensor([[[3.0, 2.0], [-4.0, 1.0]]] * 2, dtype=torch.float64)
    size = torch.full((2, 2), 1.0, dtype=torch.float64)
    drift = torch.tensor([[[0.0, 0.0], [0.2, 0.0]]] * 2, dtype=torch.float64)
    obstacles = Obstacles(place, size, 6.0 * size, drift, torch.ones(2, 2, dtype=torch.bool))
    frames = LinkFrame(frame.target[rows], frame.bearing[rows])
    return FlightCost(mission.cost.of(rows), frames, obstacles, torch.tensor([0.0, 5.0]).double(), 0.1, 0.5, 0.2)


def test_gradient_of_a_plans_cost_is_autograds(cost: FlightCost):
    x = states().expand(4, 2, 8).clone() + 0.1 * torch.arange(4.0).double()[:, None, None]
    effort = torch.ones(3, 2, 4, dtype=torch.float64)
    leaf = x.clone().requires_grad_()
    (expected,) = torch.autograd.grad(cost.total(leaf, effort).sum(), leaf)
    gradient, hessian = cost.expanded(x)
    torch.testing.assert_close(gradient, expected, rtol=1e-8, atol=1e-10)
    assert float(torch.linalg.eigvalsh(hessian).min()) > -1e-9


def test_a_plans_cost_is_that_of_the_mission(make_config, make_relay):
    """J of a flight as it is judged, but for the rounded ridge, the tail and the rule of the integral."""
    overrides = ("experiment=fig5_single", "planner=pd", "scenario.duration_s=20")
    config, env = make_config(*overrides), make_relay(*overrides)
    _, estimate = estimate_each_vehicle(env, build.make_estimator(config.estimator, env))
    evaluator = build.make_evaluator(config, env)
    judged = evaluator.fly(build.make_planner(config, config.planner, env).fit(env, estimate))
    mission, rows = evaluator.mission, torch.zeros(1, dtype=torch.long)
    frame = mission.targets.frame
    obstacles = env.scenario.obstacles.each(lambda field: field[None])
    begin = torch.zeros(1, dtype=torch.float64)
    priced = FlightCost(mission.cost.of(rows), frame, obstacles, begin, env.scenario.dt, 0.0, 0.0, ridge=1e-6)
    x = judged.trajectory.components[..., 0].transpose(1, 2)
    effort = (judged.trajectory.tau - env.vehicle.trim)[:, 0]
    last = priced.total(x[-1:], effort[:0]) - 0.0
    tail = last * (80.0 / (80.0 + 0.5 * env.scenario.dt))
    assert float(priced.total(x, effort) - tail) == pytest.approx(float(judged.cost), rel=1e-3)


def test_plans_obey_the_dynamics_and_find_the_optimum_from_a_straight_line(make_relay):
    env = make_relay("experiment=fig5_free")
    mission = Mission(env, truth_of(env).channel)
    rows, frame = torch.zeros(1, dtype=torch.long), mission.targets.frame
    none = env.scenario.obstacles.each(lambda field: field[None])
    begin = torch.zeros(1, dtype=torch.float64)
    cost = FlightCost(mission.cost.of(rows), LinkFrame(frame.target, frame.bearing), none, begin, 0.2, 0.5, 0.2)
    theta = true_theta(env.vehicle)[None]
    problem = FlightProblem(VehicleModel(Fossen(), theta, torch.zeros(1, 2).double()), cost, env.vehicle.tau_max)
    start = torch.cat([env.scenario.start[..., :4], torch.zeros(1, 4).double()], -1)
    # At rest, and without effort, at places on the way of 40 s.
    share = (torch.arange(401).double() / 200.0).clamp_max(1.0)[:, None, None]
    end = torch.cat([frame.target, frame.bearing[:, None], torch.zeros(1, 4)], -1)
    plan = optimise(problem, start, torch.lerp(start, end, share), torch.zeros(400, 1, 4).double(), 30)
    assert float(plan.defect.max()) < 0.05
    assert float(plan.effort.abs().amax()) <= 122.0
    # The optimiser of the experiments needs 3.147.
    assert float(plan.J) == pytest.approx(3.147, rel=0.01)


@pytest.fixture(scope="module")
def short() -> tuple[str, ...]:
    return ("experiment=fig5_single", "planner=identified", "planner.max_time_s=34", "planner.node_s=0.2")


def test_flies_around_obstacles_at_less_cost_than_pd(short, make_config, make_relay):
    config, env = make_config(*short), make_relay(*short)
    _, estimate = estimate_each_vehicle(env, build.make_estimator(config.estimator, env))
    planners = [build.make_planner(config, which, env) for which in (config.planner, config.baseline)]
    evaluator = build.make_evaluator(config, env)
    ours, pd = evaluator.fly_side_by_side([(planner.fit(env, estimate), 1) for planner in planners])
    assert not bool(contacts(ours.clearance).any())
    assert ours.time_to_99_percent() is not None
    # The optimiser needs 3.273.
    assert float(ours.cost) < min(3.29, float(pd.cost))


def test_a_flight_too_calm_is_refused(short, make_config, make_relay):
    calm = (*short, "planner.most_doubt=1e-9")
    config, env = make_config(*calm), make_relay(*calm)
    _, estimate = estimate_each_vehicle(env, build.make_estimator(config.estimator, env))
    planner = build.make_planner(config, config.planner, env)
    with pytest.raises(UnidentifiedError, match=r"experience\.excitation_rms: the flight was too calm to tell m_u"):
        planner.fit(env, estimate)


def test_a_carry_continues_a_flight(short, make_config, make_relay):
    """Pure: the same observation gives the same tau; the carry is the only memory."""
    config, env = make_config(*short, "scenario.duration_s=6"), make_relay(*short, "scenario.duration_s=6")
    _, estimate = estimate_each_vehicle(env, build.make_estimator(config.estimator, env))
    agent = build.make_planner(config, config.planner, env).fit(env, estimate)
    start = env.start()
    whole = env.rollout(agent, start, 100)
    half = env.rollout(agent, start, 50)
    rest = env.rollout(agent, half.end, 50, carry=half.carry)
    assert torch.equal(torch.cat([half.tau, rest.tau]), whole.tau)
    assert replace(half).tau is half.tau


def test_two_vehicles_learn_one_model(make_config, make_relay):
    """Their hovers alone have more windows than the model has parameters, and tell nearly nothing."""
    words = ("experiment=fig6_pair", "planner=identified", "planner.max_time_s=34")
    config, env = make_config(*words), make_relay(*words)
    _, estimate = estimate_each_vehicle(env, build.make_estimator(config.estimator, env))
    first, *_, last = build.make_planner(config, config.planner, env).learn(env, estimate)
    assert first.identified is None
    truth = true_theta(env.vehicle)
    torch.testing.assert_close(last.identified.theta[:4], truth[:4], rtol=0.03, atol=0.0)


def test_a_vehicle_that_rests_tells_nothing(make_relay):
    env = make_relay("experiment=fig5_free")
    eta, nu, tau = env.scenario.start[None, 0].expand(401, 1, 4), torch.zeros(401, 1, 4), torch.zeros(400, 1, 4)
    eta = eta - torch.tensor([0.0, 0.0, 5.0, 0.0])
    windows = Windows(Fossen(), env.scenario.dt, 20, 20, env.scenario.depth)
    log = Log(eta.double(), nu.double(), (tau + env.vehicle.trim).double())
    assert identify_flights(windows, [log], env.vehicle.tau_max, torch.zeros(2).double()) is None
