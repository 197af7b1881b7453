"""4-DOF underwater vehicle after Fossen (eqs 1-4): surge, sway, heave, yaw.

eta = [x, y, z, psi] in the inertial frame (m, rad), z up; nu = [u, v, w, r] in the body frame (m/s, rad/s);
tau = forces and yaw moment (N, N m).

    eta_dot = J(psi) nu
    M nu_dot + C(nu) nu + D(nu) nu + g = tau

A state is stored as one contiguous tensor [8, ...], components first. Each component is then a dense vector over all
worlds, which eager PyTorch integrates about three times faster than [..., 8] at 100,000 worlds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor, nn

from uwirl.world.geometry import to_body
from uwirl.world.integration import Body, column, rk4

# Vehicles integrated together in eager mode: enough to hide the cost of a kernel call, few enough for the cache.
CHUNK = 16_384


@dataclass(frozen=True)
class VehicleState:
    """Pose and velocity of a batch of vehicles.

    Attributes:
        components: [8, B, M], rows x, y, z, psi, u, v, w, r.
    """

    components: Tensor

    @classmethod
    def from_eta_nu(cls, eta: Tensor, nu: Tensor | None = None) -> VehicleState:
        """A state from eta and nu, both [..., 4]; at rest if nu is not given."""
        nu = torch.zeros_like(eta) if nu is None else nu
        return cls(torch.cat([eta, nu], -1).movedim(-1, 0).contiguous())

    @property
    def eta(self) -> Tensor:
        """[..., 4], a view."""
        return self.components[:4].movedim(0, -1)

    @property
    def nu(self) -> Tensor:
        """[..., 4], a view."""
        return self.components[4:].movedim(0, -1)

    @property
    def position(self) -> Tensor:
        """[..., 3], a view, m."""
        return self.components[:3].movedim(0, -1)


class Moving(Protocol):
    """Anything with a pose and a velocity: a state of vehicles, or the navigation data in their observation."""

    @property
    def eta(self) -> Tensor:
        """[..., M, 4]."""
        ...

    @property
    def nu(self) -> Tensor:
        """[..., M, 4]."""
        ...

    @property
    def position(self) -> Tensor:
        """[..., M, 3], m."""
        ...


class Dynamics(Protocol):
    """The interface that the relay environment needs from a vehicle."""

    @property
    def tau_max(self) -> Tensor:
        """Thruster limits, [4]; N, N, N, N m."""
        ...

    @property
    def trim(self) -> Tensor:
        """The tau that holds the vehicle at rest, [4]."""
        ...

    def saturate(self, tau: Tensor) -> Tensor:
        """tau [..., 4] within the thruster limits."""
        ...

    def step(
        self, state: VehicleState, tau: Tensor, dt: float, current: Tensor | None = None, out: Tensor | None = None
    ) -> VehicleState:
        """The state after dt seconds of held tau [B, M, 4], in a current [B, 3]; written into `out` if given."""
        ...


class Vehicle(nn.Module):
    """The model of (1): M, C, D, g, J as tensors, and its Runge-Kutta integration.

    Args:
        mass_kg: rigid-body mass.
        yaw_inertia: Iz, kg m^2.
        added_mass: surge, sway, heave (kg), yaw (kg m^2), as positive numbers.
        linear_damping: surge, sway, heave (N s/m), yaw (N m s/rad).
        quadratic_damping: surge, sway, heave (N s^2/m^2), yaw (N m s^2/rad^2).
        weight_N: W.
        buoyancy_N: B.
        tau_max: thruster limits, N, N, N, N m.
    """

    def __init__(
        self,
        mass_kg: float,
        yaw_inertia: float,
        added_mass: Sequence[float],
        linear_damping: Sequence[float],
        quadratic_damping: Sequence[float],
        weight_N: float,
        buoyancy_N: float,
        tau_max: Sequence[float],
        dtype: torch.dtype = torch.float64,
        device: torch.device | str = "cpu",
    ):
        super().__init__()
        rigid = [mass_kg, mass_kg, mass_kg, yaw_inertia]

        def constant(values: Sequence[float]) -> Tensor:
            return torch.tensor(list(values), dtype=dtype, device=device)

        self.inertia: Tensor
        self.linear_damping: Tensor
        self.quadratic_damping: Tensor
        self.restoring: Tensor
        self.tau_max: Tensor
        self.tau_min: Tensor
        self.register_buffer("inertia", constant([r + a for r, a in zip(rigid, added_mass, strict=True)]))
        self.register_buffer("linear_damping", constant(linear_damping))
        self.register_buffer("quadratic_damping", constant(quadratic_damping))
        # z points up, so g_w = W - B acts on heave: a buoyant vehicle is pushed towards +z.
        self.register_buffer("restoring", constant([0.0, 0.0, weight_N - buoyancy_N, 0.0]))
        self.register_buffer("tau_max", constant(tau_max))
        self.register_buffer("tau_min", -self.tau_max)

    @classmethod
    def bluerov2(cls, dtype: torch.dtype = torch.float64, device: torch.device | str = "cpu") -> Vehicle:
        """vehicle=bluerov2: C.-J. Wu, "6-DoF Modelling and Control of a Remotely Operated Vehicle", MEng thesis,
        Flinders University, 2018."""
        return cls(
            mass_kg=11.5,
            yaw_inertia=0.16,
            added_mass=[5.5, 12.7, 14.57, 0.12],
            linear_damping=[4.03, 6.22, 5.18, 0.07],
            quadratic_damping=[18.18, 21.66, 36.99, 1.55],
            weight_N=112.8,
            buoyancy_N=114.8,
            tau_max=[85.0, 85.0, 120.0, 26.0],
            dtype=dtype,
            device=device,
        )

    @property
    def trim(self) -> Tensor:
        """The tau that holds the vehicle at rest, [4]."""
        return self.restoring

    def saturate(self, tau: Tensor) -> Tensor:
        """tau [..., 4] within the thruster limits."""
        return torch.clamp(tau, self.tau_min, self.tau_max)

    def inertia_matrix(self) -> Tensor:
        """M, [4, 4]."""
        return torch.diag(self.inertia)

    def coriolis_matrix(self, nu: Tensor) -> Tensor:
        """C(nu) [..., 4, 4], skew-symmetric, of nu [..., 4]."""
        C = nu.new_zeros(*nu.shape, 4)
        C[..., 0, 3] = -self.inertia[1] * nu[..., 1]
        C[..., 1, 3] = self.inertia[0] * nu[..., 0]
        return C - C.mT

    def damping_matrix(self, nu: Tensor) -> Tensor:
        """D(nu) [..., 4, 4], diagonal, of nu [..., 4]."""
        return torch.diag_embed(self.linear_damping + self.quadratic_damping * nu.abs())

    def rk4(self, x: Tensor, tau: Tensor, dt: float, out: Tensor | None = None) -> Tensor:
        """One classical Runge-Kutta step with tau held.

        Args:
            x: [8, ...].
            tau: [4, ...].
            dt: s.
            out: where to write the result; a new tensor if None.

        Returns:
            x after dt, [8, ...].
        """
        return rk4(self.body(x), x, tau - column(self.restoring, tau), dt, out)

    def body(self, x: Tensor) -> Body:
        """The constants of (1) in the shape of the rows of a state [8, ...]."""
        return Body(*(column(q, x) for q in (self.inertia, self.linear_damping, self.quadratic_damping)))

    def drift(self, x: Tensor, tau: Tensor, dt: float, current: Tensor) -> Tensor:
        """One Runge-Kutta step in a current; nu is the velocity over ground, drag depends on that through water.

        With a current that is irrotational and held over the step, (1) holds for the velocity relative to the water
        (Fossen, "Handbook of Marine Craft Hydrodynamics and Motion Control", 2nd ed., section 10.3).

        Args:
            x: [8, ...].
            tau: [4, ...].
            dt: s.
            current: inertial, [3, ...], m/s.
        """
        relative = x.clone()
        relative[4:6] -= torch.stack(to_body(current[0], current[1], x[3]))
        relative[6] -= current[2]
        moved = self.rk4(relative, tau, dt)
        moved[:3] += current * dt
        moved[4:6] += torch.stack(to_body(current[0], current[1], moved[3]))
        moved[6] += current[2]
        return moved

    def step(
        self,
        state: VehicleState,
        tau: Tensor,
        dt: float,
        current: Tensor | None = None,
        out: Tensor | None = None,
    ) -> VehicleState:
        """The state after dt seconds of held tau [B, M, 4], which is not saturated here.

        Args:
            state: [B, M].
            tau: [B, M, 4].
            dt: s.
            current: inertial, of each world, [B, 3], m/s; None for still water.
            out: where to write the new components, contiguous [8, B, M]; a new tensor if None.
        """
        x, tau = state.components, tau.movedim(-1, 0)
        if current is not None:
            moved = self.drift(x, tau, dt, current.T[..., None])
            return VehicleState(moved if out is None else out.copy_(moved))
        chunks = -(-x[0].numel() // CHUNK)
        if chunks == 1 or x.device.type != "cpu" or torch.compiler.is_compiling():
            return VehicleState(self.rk4(x, tau, dt, out))
        out = x.new_empty(x.shape) if out is None else out
        # `view` fails instead of copying: results written into a silent copy of `out` would be lost.
        flat = x.flatten(1), tau.flatten(1), out.view(8, -1)
        parts = (t.tensor_split(chunks, 1) for t in flat)
        for part_x, part_tau, part_out in zip(*parts, strict=True):
            self.rk4(part_x, part_tau, dt, part_out)
        return VehicleState(out)
