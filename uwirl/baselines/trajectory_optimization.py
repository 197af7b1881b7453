"""Trajectory optimisation with a model: a reference for J, not a strict lower bound.

Direct collocation by the implicit trapezoid on N intervals of h seconds (Betts, Practical Methods for Optimal Control
and Estimation Using Nonlinear Programming, 2010, ch. 4), solved by an interior-point method:

    minimise    sum_i sum_k w_k h [s_ik + beta_2 E_O + yaw_weight (1 - cos psi~) + sum_a R_a (tau_a - tau_trim,a)^2]
    subject to  x_k+1 - x_k = h/2 (f(x_k, tau_k) + f(x_k+1, tau_k+1)),   x_0 = start, at rest,   |tau| <= tau_max
                s_ik >= beta_1/C^2 - beta_1/C_max^2 on both links,   l >= rho_m + r_v,   |p_i - p_j| >= separation
                -depth <= z <= 0

with w = 1/2, 1, ..., 1, 1/2. Neighbours are at their targets, so that vehicles are coupled only by the separation,
which is also required between the nodes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any, NamedTuple

import torch
from torch import Tensor

from uwirl.baselines.collocation import Collocation
from uwirl.baselines.guesses import Guess, guesses_on_the_map, interpolate
from uwirl.motion.cost import CostWeights
from uwirl.motion.mission import Mission
from uwirl.snr.estimate import ChannelEstimate
from uwirl.world.agent import Agent
from uwirl.world.geometry import rotation_matrix, wrapped
from uwirl.world.observation import Observation
from uwirl.world.relay import Relay

IPOPT = {"print_level": 0, "sb": "yes", "mu_strategy": "adaptive", "tol": 1e-6, "acceptable_tol": 1e-4}
FEASIBLE = 1e-4  # largest violation with which a plan counts as converged although the solver stopped early
# Surge, sway, heave in N/m and N s/m, yaw in N m and N m s/rad. At full thrust, the Munk moment (m_v - m_u) u v turns
# the bow away from the path with up to 30 N m/rad; the yaw gain must be larger.
POSITION_GAIN = (40.0, 40.0, 40.0, 40.0)
VELOCITY_GAIN = (40.0, 40.0, 40.0, 4.0)


class Attempt(NamedTuple):
    """Result of the solver from one guess: J, and the largest violation of a constraint."""

    name: str
    converged: bool
    cost: float
    infeasibility: float


@dataclass(frozen=True)
class Plan:
    """The best of all converged attempts; the least infeasible one if none converged.

    Attributes:
        eta, nu, tau: at the nodes, [N + 1, M, 4], float64.
        cost: J by the trapezoid over the nodes.
        converged: False if no attempt did.
        guess: name of the guess that gave this plan.
        attempts: results from all guesses.
    """

    eta: Tensor
    nu: Tensor
    tau: Tensor
    cost: float
    converged: bool
    guess: str
    attempts: tuple[Attempt, ...]


def optimise(
    mission: Mission,
    guesses: Sequence[Guess],
    intervals: int = 200,
    world: int = 0,
    separation_m: float = 1.0,
    max_iterations: int = 250,
) -> Plan:
    """Minimise J over a mission of one world's vehicles, from each guess in turn.

    Args:
        mission: start, obstacles, duration and the model of the vehicles; the model's water is still.
        guesses: at least one, on N + 1 nodes.
        intervals: number of intervals N.
        world: number of the world in the batch.
        separation_m: least distance between the centres of any two vehicles, m.
        max_iterations: largest number of solver iterations for each guess.

    Returns:
        The plan; its attribute `converged` is False if no attempt converged (this raises no error).

    Raises:
        ImportError: CasADi is not installed.
        ValueError: there is no guess, or one has another size, or the avoidance term of the cost is not supported.
    """
    if not guesses:
        raise ValueError("guesses: trajectory optimisation needs at least one")
    ca = _casadi()
    problem = Collocation(ca, mission, intervals, world, separation_m)
    ipopt = IPOPT | {"max_iter": max_iterations}
    solver = ca.nlpsol("plan", "ipopt", problem.programme, {"print_time": False, "ipopt": ipopt})
    attempts, solutions = [], []
    for guess in guesses:
        found = solver(x0=problem.initial(guess), **problem.bounds)
        infeasibility = float(ca.mmax(ca.fmax(-found["g"], found["g"] - problem.bounds["ubg"])))
        converged = solver.stats()["success"] or infeasibility < FEASIBLE
        attempts.append(Attempt(guess.name, converged, float(found["f"]), infeasibility))
        solutions.append(found["x"])
    best = min(attempts, key=lambda end: (not end.converged, end.cost if end.converged else end.infeasibility))
    eta, nu, tau = problem.nodes(solutions[attempts.index(best)])
    return Plan(eta, nu, tau, best.cost, best.converged, best.name, tuple(attempts))


def _casadi() -> Any:
    try:
        return import_module("casadi")
    except ImportError as error:
        raise ImportError("trajectory optimisation needs CasADi: pip install 'uwirl[solvers]'") from error


class PlanAgent:
    """tau = tau*(t) - K_p e - K_d (nu - nu*(t)), e the pose error eta - eta*(t) in body axes; no memory.

    The plan is interpolated linearly between its nodes; after its end, its last pose is held.

    Args:
        env: worlds of the planned mission.
        plan: eta*, nu*, tau*.
        position_gain, velocity_gain: diagonals of K_p and K_d, [4].
    """

    def __init__(
        self,
        env: Relay,
        plan: Plan,
        position_gain: Sequence[float] = POSITION_GAIN,
        velocity_gain: Sequence[float] = VELOCITY_GAIN,
    ):
        like, steps = env.vehicle.tau_max, env.scenario.steps
        at = torch.arange(steps + 1, dtype=torch.float64)
        nodes = torch.linspace(0.0, steps, len(plan.eta), dtype=torch.float64)
        self.eta, self.nu, self.tau = (interpolate(at, nodes, part).to(like) for part in (plan.eta, plan.nu, plan.tau))
        self.nu[-1], self.tau[-1] = 0.0, env.vehicle.trim
        self.position_gain, self.velocity_gain = like.new_tensor(position_gain), like.new_tensor(velocity_gain)

    def init(self, observation: Observation) -> tuple[()]:
        """The empty carry."""
        return ()

    def act(self, carry: tuple[()], observation: Observation) -> tuple[Tensor, tuple[()]]:
        """tau [B, M, 4] and the empty carry."""
        step = observation.step.clamp_max(len(self.eta) - 1)
        error = observation.eta - self.eta[step]
        error[..., 3] = wrapped(error[..., 3])
        body = (rotation_matrix(observation.eta[..., 3]).mT @ error[..., None])[..., 0]
        return self.tau[step] - self.position_gain * body - self.velocity_gain * (observation.nu - self.nu[step]), carry


@dataclass(frozen=True)
class TrajectoryOptimization:
    """Plans once, with the model, and tracks the plan; all worlds of a batch fly the plan of the first world.

    Attributes:
        cost: weights of the running cost.
        intervals: number of intervals N.
        speeds_mps: speeds of the guesses along the map, m/s.
        position_gain, velocity_gain: see PlanAgent.
    """

    cost: CostWeights
    intervals: int = 200
    speeds_mps: Sequence[float] = (0.8,)
    position_gain: Sequence[float] = POSITION_GAIN
    velocity_gain: Sequence[float] = VELOCITY_GAIN

    def plan(self, env: Relay, estimate: ChannelEstimate) -> Plan:
        """The best plan from all guesses, in the first world."""
        mission = Mission(env, estimate.channel, self.cost)
        return optimise(mission, guesses_on_the_map(mission, self.speeds_mps, self.intervals), self.intervals)

    def fit(self, env: Relay, estimate: ChannelEstimate) -> Agent:
        """Plan, and return the agent that tracks the plan."""
        return PlanAgent(env, self.plan(env, estimate), self.position_gain, self.velocity_gain)
