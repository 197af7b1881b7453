"""The calibration hover before learning: checks that the start policy is admissible, and measures the trim."""

from __future__ import annotations

import torch
from torch import Tensor

from uwirl.irl.networks import LinearActor
from uwirl.irl.policy_iteration import InadmissiblePolicyError
from uwirl.motion.cost import RelayCost
from uwirl.motion.linear_agent import LinkController
from uwirl.motion.link_frame import LinkFrame
from uwirl.world.agent import Guard, Guarded
from uwirl.world.relay import Relay
from uwirl.world.trajectory import Trajectory

# Hovers until the trim is known; each adds what the start policy's pull over some metres can hold.
HOVERS = 4


def calibration_hover(
    env: Relay, actor: LinearActor, cost: RelayCost, seconds: float, guard: Guard
) -> tuple[Trajectory, Tensor]:
    """Fly to a nearby point with the start policy and hold it, to measure the trim and check the policy.

    The point is 1 m ahead and 1 m to the side, and vertically away as the link is steep, up to 1 m: across a link the
    cost is too flat to tell anything. At the surface or the floor it is away from it, because contact would carry the
    vehicle and falsify the trim. A vehicle that its unknown net weight keeps away holds the point again, with the trim
    just measured.

    Args:
        env: the worlds.
        actor: the start policy.
        cost: the learner's running cost.
        seconds: duration, s.
        guard: guard between policy and thrusters.

    Returns:
        The flight, and tau_trim [L, 4], the mean control over its last quarter hover.

    Raises:
        InadmissiblePolicyError: the cost grew instead of falling.
    """
    steps = round(seconds / env.scenario.dt)
    quarter = steps // 4
    depth = env.scenario.depth
    state, trim = env.start(), actor.weight.new_zeros(4)
    flights: list[Trajectory] = []
    frame = _nearby(env, state.vehicles.eta, cost)
    while len(flights) < HOVERS:
        flights.append(env.rollout(Guarded(LinkController(frame, actor, trim), guard), state, steps))
        state, trim = flights[-1].end, flights[-1].tau[-quarter:].double().mean(0).flatten(0, 1)
        before, after = (cost.state(frame.relative(flight.states)).flatten(1) for flight in (flights[0], flights[-1]))
        fell = float(after[-quarter:].mean()) < float(before[:quarter].mean())
        z = flights[-1].eta[-quarter:, ..., 2]
        if fell and not bool(((z <= -depth) | (z >= 0.0)).any()):
            break
    if not fell:
        raise InadmissiblePolicyError(
            f"planner: the start policy is not admissible: holding a point beside it, its running cost grew from "
            f"{float(before[:quarter].mean()):.3g} to {float(after[-quarter:].mean()):.3g} in "
            f"{len(flights) * seconds:g} s; start from a damped policy (planner.start_gain > 0)"
        )
    return Trajectory.joined(flights), trim


def _nearby(env: Relay, eta: Tensor, cost: RelayCost) -> LinkFrame:
    """The frame of a link whose target is near vehicles at eta [B, M, 4]."""
    depth = env.scenario.depth
    along, _, rise = cost.neighbours[..., 1, :].abs().unbind(-1)
    # Towards mid-water, where there is room.
    towards = torch.where(eta[..., 2] >= -0.5 * depth, 1.0, -1.0)
    up = (rise / along).clamp_max(1.0) * towards
    ahead = torch.ones_like(eta[..., 0])
    return LinkFrame.seen_as(eta, torch.stack([ahead, ahead, up.to(eta), torch.zeros_like(ahead)], -1)).within(depth)
