"""The nonlinear programme of trajectory optimisation, in CasADi."""

from __future__ import annotations

import math
from itertools import combinations, product
from typing import Any

import torch
from torch import Tensor

from uwirl.baselines.guesses import Guess, of_world
from uwirl.motion.avoidance import Avoidance, Printed, smooth
from uwirl.motion.mission import Mission
from uwirl.world.geometry import rotation_matrix
from uwirl.world.vehicle import Vehicle

ROUNDING_M = 1e-3  # keeps the length of a link differentiable at zero
ROUNDING_MPS = 1e-2  # smooths |nu| in the quadratic damping, whose second derivative is discontinuous at rest
PARTS = 4  # parts of an interval: vehicles keep their separation at the end of each


class Collocation:
    """The nonlinear programme of one world.

    Unknowns: x = [eta, nu], u = tau / tau_max and s, the cost of the worse link. As matrices they are [8 M, N + 1],
    [4 M, N + 1] and [M, N + 1]. Each node is a column; a column has one block of M vehicles for each component.
    """

    def __init__(self, ca: Any, mission: Mission, N: int, world: int, separation_m: float):
        env, cost, targets = mission.env, mission.cost, mission.targets
        assert isinstance(env.vehicle, Vehicle), "who plans with the model needs one"
        self.ca, self.scenario, self.vehicle, self.cost, self.world = ca, env.scenario, env.vehicle, cost, world
        self.start = of_world(env.scenario.start, 2, world).cpu()
        self.M, self.N, self.h = len(self.start), N, env.scenario.duration / N
        x, u, s = (ca.SX.sym(name, k * self.M, N + 1) for name, k in (("x", 8), ("u", 4), ("s", 1)))
        self.x = ca.vertsplit(x, self.M)
        limits = env.vehicle.tau_max.tolist()
        self.tau = [limit * part for limit, part in zip(limits, ca.vertsplit(u, self.M), strict=True)]
        self.axes = self._axes()
        bearing = of_world(targets.frame.bearing, 1, world)
        offset = rotation_matrix(bearing)[:, :3, :3] @ of_world(cost.neighbours, 3, world).mT
        neighbours = of_world(targets.frame.target, 2, world)[..., None] + offset
        links = [self._link(node) for node in neighbours.unbind(-1)]
        f = ca.vertcat(*self._derivative())
        defects = x[:, 1:] - x[:, :-1] - self.h / 2.0 * (f[:, 1:] + f[:, :-1])
        J = ca.sum1(s + self._running(bearing)) @ (self.h * ca.DM([0.5] + [1.0] * (N - 1) + [0.5]))
        g = ca.veccat(defects, *(s - link for link in links), *self._gaps(separation_m))
        self.programme = {"x": ca.veccat(x, u, s), "f": J, "g": g}
        self.parts = ca.Function("parts", [self.programme["x"]], [x, ca.vertcat(*self.tau)])
        self.worse_link = ca.Function("worse_link", [x], [ca.fmax(*links)])
        low, high = self._box()
        upper = ca.vertcat(ca.DM.zeros(defects.numel()), ca.DM.inf(g.numel() - defects.numel()))
        self.bounds = {"lbx": low.numpy(force=True), "ubx": high.numpy(force=True), "lbg": 0.0, "ubg": upper}

    def _always(self, values: Tensor) -> Any:
        """One number for each vehicle [M], repeated for each node."""
        return self.ca.repmat(self.ca.DM(values.tolist()), 1, self.N + 1)

    def _axes(self) -> list[tuple[list[Any], float, float]]:
        """For each obstacle: horizontal offset from its axis, radius, influence radius."""
        obstacles = self.scenario.obstacles
        present = of_world(obstacles.present, 1, self.world).bool()
        fields = (obstacles.centre, 2), (obstacles.velocity, 2), (obstacles.radius, 1), (obstacles.influence, 1)
        values = (of_world(field, dims, self.world)[present].tolist() for field, dims in fields)
        time = self.ca.repmat(self.ca.DM([k * self.h for k in range(self.N + 1)]).T, self.M, 1)
        return [
            ([self.x[k] - centre[k] - velocity[k] * time for k in range(2)], radius, influence)
            for centre, velocity, radius, influence in zip(*values, strict=True)
        ]

    def _derivative(self) -> list[Any]:
        """Right-hand side f of the dynamics, as Vehicle.derivative in torch."""
        ca, vehicle, (psi, u, v, w, r) = self.ca, self.vehicle, self.x[3:]
        inertia, linear, quadratic = (
            values.tolist() for values in (vehicle.inertia, vehicle.linear_damping, vehicle.quadratic_damping)
        )
        m_u, m_v = inertia[:2]
        coriolis = -m_v * v * r, m_u * u * r, 0.0, (m_v - m_u) * u * v
        nu_dot = []
        for k, nu in enumerate((u, v, w, r)):
            damping = (linear[k] + quadratic[k] * ca.sqrt(nu**2 + ROUNDING_MPS**2)) * nu
            nu_dot.append((self.tau[k] - float(vehicle.restoring[k]) - coriolis[k] - damping) / inertia[k])
        c, s = ca.cos(psi), ca.sin(psi)
        return [c * u - s * v, s * u + c * v, w, r, *nu_dot]

    def _link(self, node: Tensor) -> Any:
        """beta_1/C^2 - beta_1/C_max^2 of each vehicle's link with its node [M, 3]."""
        ca, cost, channel = self.ca, self.cost, self.cost.channel
        values = (torch.as_tensor(value, dtype=torch.float64) for value in (channel.K_dB, channel.n))
        K, n = (self._always(value.expand(self.M)) for value in values)
        squared = sum((self.x[k] - self._always(node[:, k])) ** 2 for k in range(3))
        hop = ca.sqrt(squared + ROUNDING_M**2)
        snr = K - 10.0 * n * ca.log10(hop) - channel.budget.known_loss_dB(hop)
        capacity = channel.budget.bandwidth_khz * ca.log1p(10.0 ** (snr / 10.0)) / math.log(2.0)
        return cost.weights.beta_1 / capacity**2 - self._always(of_world(cost.minimum, 1, self.world))

    def _running(self, bearing: Tensor) -> Any:
        """Integrand of each vehicle's J, without the link cost."""
        ca, cost = self.ca, self.cost
        q = cost.weights.yaw_weight * (1.0 - ca.cos(self.x[3] - self._always(bearing)))
        for offset, radius, influence in self.axes:
            # Inside the cylinder, where a guess may be but no plan, 1/l would become too large.
            l = ca.sqrt(ca.fmax(sum(x**2 for x in offset), radius**2))
            q += cost.weights.beta_2 * _avoidance(ca, cost.weights.avoidance, l, influence)
        for R, tau, trim in zip(cost.R.tolist(), self.tau, self.vehicle.trim.tolist(), strict=True):
            q += R * (tau - trim) ** 2
        return q

    def _gaps(self, separation_m: float) -> list[Any]:
        """Constraints between bodies, which must be nonnegative: (l / least distance)^2 - 1."""
        reach = self.scenario.vehicle_radius
        gaps = [sum(x**2 for x in offset) / (radius + reach) ** 2 - 1.0 for offset, radius, _ in self.axes]
        # With constraints at the nodes only, two vehicles could jump over each other.
        for (i, j), k in product(combinations(range(self.M), 2), range(1, PARTS + 1)):
            apart = (p[i, :] - p[j, :] for p in self.x[:3])
            between = (d[:, :-1] + k / PARTS * (d[:, 1:] - d[:, :-1]) for d in apart)
            gaps.append(sum(d**2 for d in between) / separation_m**2 - 1.0)
        return gaps

    def _box(self) -> tuple[Tensor, Tensor]:
        """Lowest and highest values of the unknowns."""
        high = torch.full((self.N + 1, 8, self.M), torch.inf, dtype=torch.float64)
        low = -high
        low[:, 2], high[:, 2] = -self.scenario.depth, 0.0
        low[0] = high[0] = torch.cat([self.start, torch.zeros_like(self.start)], -1).T
        nodes = self.M * (self.N + 1)
        u, s = high.new_ones(4 * nodes), high.new_full((nodes,), torch.inf)
        return torch.cat([low.flatten(), -u, -s]), torch.cat([high.flatten(), u, s])

    def initial(self, guess: Guess) -> Any:
        """The unknowns of a guess, in one column."""
        parts = guess.eta, guess.nu, guess.tau / self.vehicle.tau_max
        if any(part.shape != (self.N + 1, self.M, 4) for part in parts):
            raise ValueError(f"guesses: {guess.name} is not [{self.N + 1}, {self.M}, 4]")
        eta, nu, u = (part.double().mT.flatten(1).T.numpy(force=True) for part in parts)
        x = self.ca.vertcat(eta, nu)
        return self.ca.veccat(x, u, self.worse_link(x))

    def nodes(self, unknowns: Any) -> tuple[Tensor, Tensor, Tensor]:
        """eta, nu and tau, [N + 1, M, 4] each."""
        parts = (torch.from_numpy(part.full()).T for part in self.parts(unknowns))
        x, tau = (part.reshape(self.N + 1, -1, self.M).mT for part in parts)
        return x[..., :4], x[..., 4:], tau


def _avoidance(ca: Any, avoidance: Avoidance, l: Any, influence: float) -> Any:
    """E_O of one obstacle, as the avoidance term in torch."""
    bracket = 1.0 / l - 1.0 / influence
    if isinstance(avoidance, Printed):
        return ca.exp(-0.5 * (l / avoidance.nu) ** (2.0 * avoidance.c)) * bracket**2
    if avoidance is not smooth:
        raise ValueError(f"cost.avoidance: trajectory optimisation does not know {avoidance}")
    return ca.fmax(bracket, 0.0) ** 2
