"""What went wrong in a run: sentences for the log, and for `warnings` in metrics.json."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import torch

from uwirl.motion.learning import IterationRecord
from uwirl.motion.targets import mean_channel_targets
from uwirl.study.campaign import Outcomes
from uwirl.study.evaluation import Evaluation
from uwirl.world.obstacles import contacts
from uwirl.world.relay import Relay
from uwirl.world.scenario import Scenario
from uwirl.world.truth import truth_of
from uwirl.world.vehicle import Vehicle

# J may rise by this share before a run is said to have ended worse; the best of many iterates is better by chance.
WORSE_THAN_START, WORSE_THAN_BEST = 1e-3, 0.01
# From this share of the steps on, thrusters are saturated nearly always.
NEARLY_ALWAYS = 0.9
# A chain whose best capacity is less carries nothing, kbit/s.
NOTHING_KBPS = 1e-3


def mission_warnings(env: Relay) -> Iterator[str]:
    """What no planner can reach in a mission of one world: a target too far away, or a channel too short."""
    scenario, truth, vehicle = env.scenario, truth_of(env), env.vehicle
    target = mean_channel_targets(scenario, truth.channel).frame.target
    best = float(truth.link_capacities_kbps(target).amin())
    if best < NOTHING_KBPS:
        snr = float(truth.link_snr_dB(target).amin())
        yield (
            f"channel: even at the best places the chain carries only {best:.2g} kbit/s, with an SNR of {snr:.0f} dB; "
            f"it needs more vehicles (scenario.start) or a channel that reaches farther"
        )
    if not isinstance(vehicle, Vehicle):
        return
    # Terminal speeds under full thrust along surge, sway and heave, then of both horizontal ones at once.
    linear, quadratic = vehicle.linear_damping[:3], vehicle.quadratic_damping[:3]
    u, v, w = ((linear.square() + 4.0 * quadratic * vehicle.tau_max[:3]).sqrt() - linear) / (2.0 * quadratic)
    drift = torch.linalg.vector_norm(scenario.current.mean, dim=-1).max()
    way = target - scenario.start[..., :3]
    across, upwards = torch.linalg.vector_norm(way[..., :2], dim=-1), way[..., 2].abs()
    need = torch.maximum(across / (torch.hypot(u, v) + drift), upwards / (w + drift)).flatten()
    i = int(need.argmax())
    if float(need[i]) > scenario.duration:
        yield (
            f"scenario.duration_s: {scenario.duration:g} s are too short: vehicle {i + 1} starts "
            f"{float(torch.linalg.vector_norm(way, dim=-1).flatten()[i]):.0f} m from its target, at least "
            f"{float(need[i]):.0f} s away at full thrust"
        )


def flight_warnings(scenario: Scenario, evaluation: Evaluation) -> Iterator[str]:
    """What went wrong in the mission of the first world."""
    yield from _hits(scenario, evaluation)
    yield from _collisions(scenario, evaluation)
    blocked = evaluation.blocked[0].nonzero()[:, 0].tolist()
    for i in blocked:
        yield (
            f"vehicle {i + 1} is blocked: between the obstacles that it knows, no way to its target is wide enough for "
            f"the vehicle and the guard's margin"
        )
    if evaluation.time_to_99_percent() is None and not blocked:
        end, best = float(evaluation.chain_capacity[-1, 0]), evaluation.optimal_capacity
        yield (
            f"the chain does not keep 99 % of its best capacity: it ends with {end:.3f} of {best:.3f} kbit/s after "
            f"{scenario.duration:g} s (scenario.duration_s)"
        )
    for i, share in enumerate(evaluation.saturated[:, 0].double().mean(0).tolist()):
        if share >= NEARLY_ALWAYS:
            yield f"a thruster limit of vehicle {i + 1} is reached in {share:.0%} of the control steps"


def _hits(scenario: Scenario, evaluation: Evaluation) -> Iterator[str]:
    """Contacts with obstacles, one sentence a vehicle."""
    clearance, trajectory = evaluation.clearance[:, 0], evaluation.trajectory
    for i, number in enumerate(contacts(clearance).tolist()):
        if number:
            first, deepest = int((clearance[:, i] < 0.0).nonzero()[0]), int(clearance[:, i].argmin())
            time, place = float(trajectory.time[deepest]), trajectory.eta[deepest, 0, i, None, :3]
            obstacle = int(scenario.obstacles.clearance(place, scenario.vehicle_radius, time).argmin())
            yield (
                f"vehicle {i + 1} hit obstacles: {number} contacts, first at {float(trajectory.time[first]):.2f} s, "
                f"the deepest {-float(clearance[deepest, i]):.2f} m into obstacle {obstacle + 1}, at {time:.2f} s"
            )


def _collisions(scenario: Scenario, evaluation: Evaluation) -> Iterator[str]:
    """Vehicles closer than two radii, one sentence a pair."""
    position, time = evaluation.trajectory.eta[:, 0, :, :3], evaluation.trajectory.time
    for i, j in torch.triu_indices(position.shape[1], position.shape[1], 1).T.tolist():
        apart = torch.linalg.vector_norm(position[:, i] - position[:, j], dim=-1)
        nearest = int(apart.argmin())
        depth = 2.0 * scenario.vehicle_radius - float(apart[nearest])
        if depth > 0.0:
            yield f"vehicles {i + 1} and {j + 1} collided: {depth:.2f} m deep at {float(time[nearest]):.2f} s"


NO_MODEL = (
    "no model of the vehicle was identified, so that it flies along routes by what is declared of it: excite more "
    "(experience.excitation_rms) or fly longer (planner.max_time_s, no more than that in planner.model_time_s)"
)


def learning_warnings(
    records: Sequence[IterationRecord], costs: Sequence[float | None], start: float, end: float
) -> Iterator[str]:
    """Where learning ended badly.

    Args:
        records: the policy iterations.
        costs: J of the iterates, None for those that were not flown again, as in `cost_per_iteration`.
        start: J of the start policy.
        end: J of the policy that was learned.
    """
    last = records[-1]
    if not last.converged:
        change = max(record.weight_change for record in records if record.seconds == last.seconds)
        yield (
            f"learning did not converge within {last.seconds:g} s of flight: weights still change by "
            f"{change:.1e} (planner.max_time_s, planner.tolerance_weights)"
        )
    if not end <= (1.0 + WORSE_THAN_START) * start:
        yield f"learning ended worse than the start policy: J {end:.3f} instead of {start:.3f}"
    least, best = min((math.inf if math.isnan(J) else J, k) for k, J in enumerate(costs, 1) if J is not None)
    if not end <= (1.0 + WORSE_THAN_BEST) * least:
        yield (
            f"the last iterate is worse than iterate {best}, the best: J {end:.3f} instead of {least:.3f}; "
            f"`uwirl-evaluate` flies the best with checkpoint=.../checkpoints/best.pt"
        )


def campaign_warnings(outcomes: Outcomes) -> Iterator[str]:
    """What went wrong in the worlds of a campaign."""
    N, hit = len(outcomes.kind), outcomes.collisions > 0
    if bool(hit.any()):
        deepest = -float(outcomes.clearance.min())
        yield f"obstacles were hit in {int(hit.sum())} of {N} worlds, at most {deepest:.2f} m deep"
    counted = outcomes.of(outcomes.counted)
    blocked, missed = int(counted.blocked.sum()), int((~counted.reached & ~counted.blocked).sum())
    if blocked:
        yield f"vehicles report to be blocked in {blocked} of {len(counted.kind)} worlds that have a free route"
    if missed:
        yield f"99 % of the best capacity is not kept in {missed} of {len(counted.kind)} worlds that have a free route"
