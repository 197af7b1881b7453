"""Evaluation of agents: fly a mission on the true channel and measure."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor
from tqdm import tqdm

from uwirl.motion.cost import CostWeights
from uwirl.motion.identification import Identified
from uwirl.motion.learning import Learning
from uwirl.motion.mission import Mission
from uwirl.motion.safety import Unguarded
from uwirl.study.progress import bar
from uwirl.world.agent import Agent, Guard, Guarded, SideBySide, slices
from uwirl.world.geometry import length
from uwirl.world.observation import Observation
from uwirl.world.obstacles import contacts
from uwirl.world.relay import Relay
from uwirl.world.trajectory import Trajectory, WorldState, at_rest
from uwirl.world.truth import truth_of

# Smaller differences of tau, relative to the thruster limits, are rounding, also in float32.
ROUNDING = 1e-5


@dataclass(frozen=True)
class Evaluation:
    """One mission of B worlds.

    Attributes:
        trajectory: the flown trajectory.
        link_capacity: mean capacity of each link, [n + 1, B, M + 1], kbit/s.
        optimal_capacity: capacity of the chain at its targets, kbit/s.
        clearance: of each vehicle to the nearest obstacle, [n + 1, B, M], m; infinite in free water.
        blocked: whether the agent found no free route to the vehicle's target at the end, [B, M].
        cost_terms: J of each world by term (link, obstacle, vehicle, control), [B] each.
        saturated: whether a thruster limit was reached at each step, [n, B, M].
        intervened: whether the guard changed tau at each step, [n, B, M]; None if this is not known.
    """

    trajectory: Trajectory
    link_capacity: Tensor
    optimal_capacity: float
    clearance: Tensor
    blocked: Tensor
    cost_terms: dict[str, Tensor]
    saturated: Tensor
    intervened: Tensor | None = None

    @property
    def chain_capacity(self) -> Tensor:
        """Capacity of the worst link (5), [n + 1, B], kbit/s."""
        return self.link_capacity.amin(-1)

    @property
    def cost(self) -> Tensor:
        """Cost J of each world, [B]."""
        return torch.stack(list(self.cost_terms.values())).sum(0)

    @property
    def arrival(self) -> Tensor:
        """First time after which the chain's mean capacity stays >= 99 % of its optimum, [B], s; infinite if never."""
        short = self.chain_capacity < 0.99 * self.optimal_capacity
        passed = torch.arange(1, len(short) + 1, device=short.device)[:, None] * short
        first = passed.amax(0)
        return torch.where(first < len(short), first.double() * self.trajectory.dt, torch.inf)

    @property
    def separation(self) -> Tensor:
        """Smallest distance between the centres of two vehicles, [B], m; infinite for a single one."""
        position = self.trajectory.eta[..., :3]
        i, j = torch.triu_indices(position.shape[2], position.shape[2], 1, device=position.device)
        apart = length(position[:, :, i] - position[:, :, j])
        return torch.nn.functional.pad(apart, (0, 1), value=torch.inf).amin((0, 2))

    def time_to_99_percent(self, world: int = 0) -> float | None:
        """The arrival of one world, s; None if it never arrives."""
        return finite(float(self.arrival[world]))

    @property
    def interventions(self) -> Tensor | None:
        """Number of control steps at which the guard changed some vehicle's tau, [B]; None if this is not known."""
        return None if self.intervened is None else self.intervened.any(-1).sum(0)

    def metrics(self, world: int = 0) -> dict[str, float | list | None]:
        """The mission's entries in metrics.json."""
        capacity = self.chain_capacity[:, world]
        t99 = self.time_to_99_percent(world)
        arrival = self.trajectory.tau.shape[0] if t99 is None else round(t99 / self.trajectory.dt)
        eta, nu = self.trajectory.eta[:, world], self.trajectory.nu[:, world]
        travelled = length(eta[: arrival + 1, :, :3].diff(dim=0)).sum()
        mean_nu = (nu[1:] + nu[:-1]) / 2.0
        acts = None if self.interventions is None else int(self.interventions[world])
        power = (self.trajectory.tau[:, world] * mean_nu).sum(-1).abs()
        return {
            "capacity_initial_mean_kbps": float(capacity[0]),
            "capacity_final_mean_kbps": float(capacity[-1]),
            "capacity_optimal_mean_kbps": self.optimal_capacity,
            "capacity_gain_percent": 100.0 * (float(capacity[-1] / capacity[0]) - 1.0),
            "link_capacity_final_kbps": self.link_capacity[-1, world].tolist(),
            "time_to_99_percent_s": t99,
            "final_position_m": eta[-1, :, :3].tolist(),
            "collisions": int(contacts(self.clearance[:, world]).sum()),
            "min_obstacle_clearance_m": float(self.clearance[:, world].min()),
            "min_vehicle_separation_m": finite(float(self.separation[world])),
            "blocked": int(self.blocked[world].sum()),
            "guard_interventions": acts,
            "guard_intervention_share": None if acts is None else acts / len(self.saturated),
            "saturated_share": float(self.saturated[:, world].double().mean()),
            "path_length_m": float(travelled),
            "energy_J": float(power.sum()) * self.trajectory.dt,
            "cost_total": float(self.cost[world]),
            **{f"cost_{term}": float(value[world]) for term, value in self.cost_terms.items()},
        }


def finite(value: float) -> float | None:
    """A number for metrics.json, None if it is infinite or nan."""
    return value if math.isfinite(value) else None


class Wanted:
    """A guard that remembers what the agent wanted during one flight.

    Args:
        guard: the guard that acts.
        progress: gets the number of worlds at each step.
    """

    def __init__(self, guard: Guard, progress: tqdm):
        self.guard, self.progress = guard, progress
        self.tau: list[Tensor] = []

    def __call__(self, tau: Tensor, observation: Observation) -> Tensor:
        """What the guard makes of tau."""
        self.tau.append(tau)
        self.progress.update(len(tau))
        return self.guard(tau, observation)


class Evaluator:
    """Flies agents on the true channel.

    Args:
        env: the worlds.
        weights: weights of the running cost; effort is measured from the vehicle's true trim.
        guard: guard between agent and thrusters; none if None.
        progress: whether to show a bar during flights, on a terminal.
    """

    def __init__(
        self, env: Relay, weights: CostWeights | None = None, guard: Guard | None = None, progress: bool = False
    ):
        self.env, self.guard, self.progress = env, guard or Unguarded(), progress
        self.truth = truth_of(env)
        self.mission = Mission(env, self.truth.channel, weights or CostWeights())

    def in_worlds(self, env: Relay) -> Evaluator:
        """The same evaluator for other worlds."""
        return Evaluator(env, self.mission.weights, self.guard, self.progress)

    def fly(self, agent: Agent, start: WorldState | None = None, progress: tqdm | None = None) -> Evaluation:
        """Fly one mission.

        Args:
            agent: who flies.
            start: state to start from, see `Relay.rollout`; the scenario's start if None.
            progress: a bar of more than this flight, in steps of one world; one of this flight if None.
        """
        return self.judge(*self._flown(agent, self.env.start() if start is None else start, progress))

    def _flown(self, agent: Agent, start: WorldState, progress: tqdm | None = None) -> tuple[Trajectory, Tensor]:
        """A flight and the agent's tau before the guard, [n, B, M, 4]."""
        steps = self.env.scenario.steps * len(start.step)
        with nullcontext(progress) if progress is not None else bar("flying", steps, self.progress) as shown:
            wanted = Wanted(self.guard, shown)
            trajectory = self.env.rollout(Guarded(agent, wanted), start)
        return trajectory, torch.stack(wanted.tau)

    def judge(self, trajectory: Trajectory, wanted: Tensor | None = None, blocked: Tensor | None = None) -> Evaluation:
        """Evaluate a flown trajectory.

        Args:
            trajectory: B worlds of it.
            wanted: the agent's tau before the guard, [n, B, M, 4]; None if unknown.
            blocked: vehicles without a free route to their target at the end, [B, M]; if None, as the carry says.
        """
        scenario, cost, frame = self.env.scenario, self.mission.cost, self.mission.targets.frame
        xi, dt = frame.relative(trajectory.states), trajectory.dt
        position, time = trajectory.states.position, trajectory.time[:, None]
        if blocked is None:
            # Only agents that plan routes report this.
            nowhere = torch.zeros(position.shape[1:3], dtype=torch.bool, device=position.device)
            blocked = getattr(trajectory.carry, "blocked", nowhere)
        vehicle, tau = self.env.vehicle, trajectory.tau

        def trapezoid(q: Tensor) -> Tensor:
            return torch.trapezoid(q, dx=dt, dim=0).sum(-1)

        return Evaluation(
            trajectory=trajectory,
            link_capacity=self.truth.link_capacities_kbps(position),
            optimal_capacity=float(self.truth.link_capacities_kbps(frame.target).amin()),
            clearance=scenario.clearance(position, time),
            blocked=blocked,
            cost_terms={
                "link": trapezoid(cost.link(xi)),
                "obstacle": trapezoid(cost.obstacle(scenario.obstacles, position, time)),
                "vehicle": trapezoid(cost.yaw(xi)),
                # Control is constant over each step, so the sum is exact.
                "control": cost.control(tau - vehicle.trim).sum((0, -1)) * dt,
            },
            saturated=(tau.abs() >= (1.0 - ROUNDING) * vehicle.tau_max).any(-1),
            intervened=None
            if wanted is None
            else ((vehicle.saturate(wanted) - tau).abs() > ROUNDING * vehicle.tau_max).any(-1),
        )

    def fly_side_by_side(
        self, agents: Sequence[tuple[Agent, int]], groups: Sequence[int] | None = None
    ) -> list[Evaluation]:
        """Fly the first world's mission with several agents, as one batch.

        Args:
            agents: each with the number of its worlds.
            groups: numbers of consecutive worlds that are judged together; those of the agents if None. Sums over time
                depend in their last digit on the number of worlds, flights do not.

        Returns:
            The missions of each group.
        """
        numbers = [number for _, number in agents]
        first, start = self._first, self._first.env.scenario.start
        together = SideBySide([agent for agent, _ in agents], numbers)
        trajectory, tau = first._flown(together, at_rest(start.expand(sum(numbers), *start.shape[-2:])))
        blocked = trajectory.carry.blocked
        some = slices(numbers if groups is None else groups)
        return [first.judge(trajectory.worlds(part), tau[:, part], blocked[part]) for part in some]

    def agent_of_weights(
        self, learning: Learning, weights: Tensor, trim: Tensor, known: Identified | None, starts: int = 1
    ) -> Agent:
        """The agent that flies K sets of actor weights, each in Q consecutive copies of the first world.

        Args:
            learning: creates the agent.
            weights: one set for all vehicles, [K, 1, n3], or one for each, [K, M, n3].
            trim: tau that holds a vehicle at rest, [1 or at least M, 4]; rows of the first world are used.
            known: see `Learning.agent`.
            starts: Q.
        """
        K, M = len(weights), self.env.scenario.vehicles
        rows = weights[:, None].expand(K, starts, M, -1).flatten(0, 2)
        return learning.agent(rows, trim[:M].expand(M, 4).repeat(K * starts, 1), self._first.env, known)

    def cost_of_weights(
        self, learning: Learning, weights: Tensor, trim: Tensor, known: Identified | None, starts: Tensor
    ) -> Tensor:
        """J of K iterates' actor weights from Q starts, all flown as one batch in the first world.

        Args:
            learning, weights, trim, known: see `agent_of_weights`.
            starts: eta, [Q, M, 4].

        Returns:
            [K, Q].
        """
        K, Q = len(weights), len(starts)
        agent = self.agent_of_weights(learning, weights, trim, known, Q)
        return self._first.fly(agent, at_rest(starts.repeat(K, 1, 1))).cost.view(K, Q)

    @cached_property
    def _first(self) -> Evaluator:
        """The evaluator of the first world."""
        return self.in_worlds(self.env.select(torch.zeros(1, dtype=torch.long, device=self.env.scenario.source.device)))
