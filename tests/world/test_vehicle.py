"""The vehicle: closed forms, Fossen's Coriolis matrix, SciPy's integrator, order, symmetries, energy, batches."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from scipy.integrate import solve_ivp
from torch import Tensor

from uwirl.world import vehicle as vehicle_module
from uwirl.world.geometry import rotation_matrix
from uwirl.world.integration import column, derivative, rk4_by_components, rk4_by_rows
from uwirl.world.vehicle import Vehicle, VehicleState

# The published ones; others are the same equations with other numbers, to which times and steps here are not fitted.
PRESETS = ("bluerov2", "bluerov2_heavy")
BATCH = (6, 2)


@pytest.fixture(params=PRESETS)
def settings(request: pytest.FixtureRequest, make_config) -> dict:
    return make_config(f"vehicle={request.param}").vehicle.values()


@pytest.fixture
def vehicle(settings: dict) -> Vehicle:
    return Vehicle(**settings)


@pytest.fixture
def bluerov2(make_config) -> Vehicle:
    return Vehicle(**make_config("vehicle=bluerov2").vehicle.values())


def normal(*shape: int, seed: int = 0) -> Tensor:
    return torch.randn(*shape, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))


def random_state(*batch: int, seed: int = 0) -> VehicleState:
    return VehicleState.from_eta_nu(3.0 * normal(*batch, 4, seed=seed), normal(*batch, 4, seed=seed + 1))


def fly(vehicle: Vehicle, state: VehicleState, tau: Tensor, dt: float, steps: int) -> Tensor:
    """States at every step boundary, [steps + 1, 8, ...]."""
    states = [state.components]
    for _ in range(steps):
        state = vehicle.step(state, tau, dt)
        states.append(state.components)
    return torch.stack(states)


def rate(vehicle: Vehicle, state: VehicleState, tau: Tensor) -> Tensor:
    """The fused derivative of a state, [..., 8]."""
    x = state.components
    force = tau.movedim(-1, 0) - column(vehicle.restoring, x)
    return derivative(vehicle.body(x), x[3:], force).movedim(0, -1)


def reference_rate(_: float, x: np.ndarray, s: dict, tau: np.ndarray) -> np.ndarray:
    """(1) written out from the vehicle's data, sharing nothing with the package."""
    psi, (u, v, w, r) = x[3], x[4:]
    mass = np.array([s["mass_kg"]] * 3 + [s["yaw_inertia"]]) + s["added_mass"]
    coriolis = np.array([-mass[1] * v * r, mass[0] * u * r, 0.0, (mass[1] - mass[0]) * u * v])
    damping = np.array(s["linear_damping"]) * x[4:] + np.array(s["quadratic_damping"]) * np.abs(x[4:]) * x[4:]
    net_weight = np.array([0.0, 0.0, s["weight_N"] - s["buoyancy_N"], 0.0])
    eta_dot = [u * np.cos(psi) - v * np.sin(psi), u * np.sin(psi) + v * np.cos(psi), w, r]
    return np.concatenate([eta_dot, (tau - coriolis - damping - net_weight) / mass])


def smooth_flight(settings: dict) -> tuple[np.ndarray, np.ndarray]:
    """A start and a tau under which no velocity changes sign, because |v| v has a kink in its second derivative."""
    start = np.array([0.0, 0.0, -5.0, 0.3, 0.4, 0.3, 0.3, 0.2])
    net_weight = settings["weight_N"] - settings["buoyancy_N"]
    return start, np.array([20.0, 30.0, 20.0 + net_weight, 6.0])


def end_error(settings: dict, dt: float, duration: float = 2.0) -> float:
    start, tau = smooth_flight(settings)
    state = VehicleState(torch.from_numpy(start)[:, None, None].clone())
    flown = fly(Vehicle(**settings), state, torch.from_numpy(tau).expand(1, 1, 4), dt, round(duration / dt))
    assert bool((flown[:, 4:] > 0.0).all())
    exact = solve_ivp(reference_rate, (0.0, duration), start, "DOP853", args=(settings, tau), rtol=1e-12, atol=1e-14).y[
        :, -1
    ]
    return float(np.abs(flown[-1, :, 0, 0].numpy() - exact).max())


def test_terminal_surge_published(bluerov2: Vehicle):
    tau = bluerov2.trim.repeat(1, 4, 1)
    tau[0, :, 0] = torch.tensor([10.0, 20.0, 30.0, 40.0])
    surge = fly(bluerov2, VehicleState.from_eta_nu(torch.zeros_like(tau)), tau, 0.05, 600)[-1, 4, 0]
    assert [f"{u:.5f}" for u in surge.tolist()] == ["0.63906", "0.94387", "1.17852", "1.37661"]


def test_terminal_speed_closed_form(vehicle: Vehicle, settings: dict):
    force = torch.tensor([-25.0, -5.0, 8.0, 20.0], dtype=torch.float64)
    # One vehicle for each axis and force, driven along that axis alone.
    alone = torch.einsum("f,ij->ifj", force, torch.eye(4, dtype=torch.float64))
    state = VehicleState.from_eta_nu(torch.zeros_like(alone))
    flown = fly(vehicle, state, vehicle.trim + alone, 0.05, 800)[-1, 4:].movedim(0, -1)
    linear, quadratic = (torch.tensor(settings[f"{k}_damping"], dtype=torch.float64) for k in ("linear", "quadratic"))
    speed = (-linear + (linear**2 + 4.0 * quadratic * alone.abs()).sqrt()) / (2.0 * quadratic)
    torch.testing.assert_close(flown, speed * alone.sign(), rtol=1e-12, atol=1e-12)


def test_coriolis_does_no_work(vehicle: Vehicle):
    nu = normal(1000, 4)
    C = vehicle.coriolis_matrix(nu)
    assert float((nu[:, None] @ C @ nu[..., None]).abs().max()) < 1e-12
    assert torch.equal(C, -C.mT)


def test_coriolis_is_fossens(vehicle: Vehicle):
    # Fossen's theorem for a diagonal inertia in six degrees of freedom, of which rows u, v, w, r are kept.
    def skew(a: np.ndarray) -> np.ndarray:
        return np.array([[0.0, -a[2], a[1]], [a[2], 0.0, -a[0]], [-a[1], a[0], 0.0]])

    nu = normal(20, 4)
    mass = vehicle.inertia.numpy()
    for row, C in zip(nu.numpy(), vehicle.coriolis_matrix(nu).numpy(), strict=True):
        linear, angular = mass[:3] * row[:3], np.array([0.0, 0.0, mass[3] * row[3]])
        six = np.block([[np.zeros((3, 3)), -skew(linear)], [-skew(linear), -skew(angular)]])
        full = np.array([*row[:3], 0.0, 0.0, row[3]])
        np.testing.assert_allclose(C @ row, (six @ full)[[0, 1, 2, 5]], rtol=1e-13, atol=1e-13)


def test_fused_derivative_is_the_matrix_form(vehicle: Vehicle):
    state, tau = random_state(*BATCH), 30.0 * normal(*BATCH, 4, seed=9)
    nu = state.nu[..., None]
    loads = (vehicle.coriolis_matrix(state.nu) + vehicle.damping_matrix(state.nu)) @ nu
    nu_dot = torch.linalg.solve(vehicle.inertia_matrix(), tau[..., None] - loads - vehicle.restoring[:, None])
    eta_dot = rotation_matrix(state.eta[..., 3]) @ nu
    expected = torch.cat([eta_dot, nu_dot], -2)[..., 0]
    torch.testing.assert_close(rate(vehicle, state, tau), expected, rtol=1e-12, atol=1e-12)


def test_derivative_is_the_equation_written_out(vehicle: Vehicle, settings: dict):
    state, tau = random_state(20), 30.0 * normal(20, 4, seed=9)
    rows = zip(state.components.T.numpy(), tau.numpy(), strict=True)
    expected = [reference_rate(0.0, x, settings, t) for x, t in rows]
    np.testing.assert_allclose(rate(vehicle, state, tau).numpy(), expected, rtol=1e-12, atol=1e-12)


def test_both_forms_of_a_step_are_the_same_to_the_last_bit(vehicle: Vehicle):
    state, force = random_state(20), 30.0 * normal(4, 20, seed=9)
    body = vehicle.body(state.components)
    rows, components = (form(body, state.components, force, 0.05) for form in (rk4_by_rows, rk4_by_components))
    assert torch.equal(rows, components)


def test_rk4_agrees_with_scipy(settings: dict):
    assert end_error(settings, 0.001, duration=1.0) < 1e-9


def test_rk4_is_of_fourth_order(settings: dict):
    errors = [end_error(settings, dt) for dt in (0.02, 0.01, 0.005)]
    assert errors[0] / errors[1] == pytest.approx(16.0, rel=0.1)
    assert errors[1] / errors[2] == pytest.approx(16.0, rel=0.1)


def test_batch_equals_its_singles(vehicle: Vehicle):
    state, tau = random_state(*BATCH), 30.0 * normal(*BATCH, 4, seed=9)
    together = fly(vehicle, state, tau, 0.05, 20)
    for b in range(BATCH[0]):
        for m in range(BATCH[1]):
            alone = VehicleState(state.components[:, b : b + 1, m : m + 1])
            single = fly(vehicle, alone, tau[b : b + 1, m : m + 1], 0.05, 20)
            torch.testing.assert_close(together[:, :, b, m], single[:, :, 0, 0], rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("chunk", [1, 5, 11])
def test_chunks_equal_the_whole(bluerov2: Vehicle, monkeypatch: pytest.MonkeyPatch, chunk: int):
    state, tau = random_state(*BATCH), 30.0 * normal(*BATCH, 4, seed=9)
    whole = bluerov2.step(state, tau, 0.05).components
    monkeypatch.setattr(vehicle_module, "CHUNK", chunk)
    torch.testing.assert_close(bluerov2.step(state, tau, 0.05).components, whole, rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("chunk", [5, 100])
def test_step_writes_where_it_is_told(bluerov2: Vehicle, monkeypatch: pytest.MonkeyPatch, chunk: int):
    state, tau = random_state(*BATCH), 30.0 * normal(*BATCH, 4, seed=9)
    expected = bluerov2.step(state, tau, 0.05).components
    monkeypatch.setattr(vehicle_module, "CHUNK", chunk)
    out = torch.full((2, 8, *BATCH), -1.0, dtype=torch.float64)
    following = bluerov2.step(state, tau, 0.05, out=out[1])
    torch.testing.assert_close(out[1], expected, rtol=0.0, atol=1e-12)
    assert following.components.data_ptr() == out[1].data_ptr()
    assert bool((out[0] == -1.0).all())


def test_chunks_ignore_the_memory_layout(bluerov2: Vehicle, monkeypatch: pytest.MonkeyPatch):
    # As Trajectory.states views a flight's [steps, 8, B, M] as [8, steps, B, M].
    flight = torch.stack([random_state(*BATCH, seed=seed).components for seed in (0, 2, 4)])
    states, tau = VehicleState(flight.movedim(0, 1)), 30.0 * normal(3, *BATCH, 4, seed=9)
    whole = bluerov2.step(states, tau, 0.05).components
    monkeypatch.setattr(vehicle_module, "CHUNK", 5)
    torch.testing.assert_close(bluerov2.step(states, tau, 0.05).components, whole, rtol=0.0, atol=1e-12)


def test_trim_holds_at_rest(vehicle: Vehicle):
    state = VehicleState.from_eta_nu(3.0 * normal(*BATCH, 4))
    flown = fly(vehicle, state, vehicle.trim.expand(*BATCH, 4), 0.05, 100)
    assert torch.equal(flown, flown[:1].expand_as(flown))


def test_buoyant_vehicle_rises_without_trim(vehicle: Vehicle):
    state = VehicleState.from_eta_nu(torch.zeros(1, 1, 4, dtype=torch.float64))
    depth = fly(vehicle, state, torch.zeros(1, 1, 4, dtype=torch.float64), 0.05, 40)[:, 2, 0, 0]
    assert bool((depth.diff() > 0.0).all())


def test_yaw_equivariance(vehicle: Vehicle):
    angle = 0.83
    c, s = math.cos(angle), math.sin(angle)
    turn = torch.eye(8, dtype=torch.float64)
    turn[:2, :2] = torch.tensor([[c, -s], [s, c]], dtype=torch.float64)
    state, tau = random_state(*BATCH), 30.0 * normal(*BATCH, 4, seed=9)
    turned = torch.einsum("ij,jbm->ibm", turn, state.components)
    turned[3] += angle
    flown = fly(vehicle, state, tau, 0.05, 60)
    expected = torch.einsum("ij,sjbm->sibm", turn, flown)
    expected[:, 3] += angle
    torch.testing.assert_close(fly(vehicle, VehicleState(turned), tau, 0.05, 60), expected, rtol=0.0, atol=1e-11)


def test_energy_is_lost_to_damping_alone(vehicle: Vehicle):
    state = random_state(1000)
    nu = state.nu[..., None]
    nu_dot = rate(vehicle, state, vehicle.trim.expand(1000, 4))[..., 4:, None]
    gain = nu.mT @ vehicle.inertia_matrix() @ nu_dot
    torch.testing.assert_close(gain, -nu.mT @ vehicle.damping_matrix(state.nu) @ nu, rtol=1e-12, atol=1e-12)


def test_energy_falls_in_trim(vehicle: Vehicle):
    flown = fly(vehicle, random_state(*BATCH), vehicle.trim.expand(*BATCH, 4), 0.02, 200)
    nu = flown[:, 4:].movedim(1, -1)[..., None]
    energy = (nu.mT @ vehicle.inertia_matrix() @ nu)[..., 0, 0] / 2.0
    assert bool((energy.diff(dim=0) < 0.0).all())


def test_state_keeps_eta_and_nu():
    eta, nu = normal(*BATCH, 4), normal(*BATCH, 4, seed=1)
    state = VehicleState.from_eta_nu(eta, nu)
    assert state.components.shape == (8, *BATCH)
    assert state.components.is_contiguous()
    assert torch.equal(state.eta, eta)
    assert torch.equal(state.nu, nu)
    assert torch.equal(state.position, eta[..., :3])
