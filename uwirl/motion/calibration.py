"""The calibration hover before learning: checks that the start policy is admissible, and measures the trim."""

from __future__ import annotations

from torch import Tensor

from uwirl.irl.networks import LinearActor
from uwirl.irl.policy_iteration import InadmissiblePolicyError
from uwirl.motion.cost import RelayCost
from uwirl.motion.linear_agent import LinkController
from uwirl.motion.link_frame import LinkFrame
from uwirl.world.agent import Guard, Guarded
from uwirl.world.relay import Relay
from uwirl.world.trajectory import Trajectory


def calibration_hover(
    env: Relay, actor: LinearActor, cost: RelayCost, seconds: float, guard: Guard
) -> tuple[Trajectory, Tensor]:
    """Fly to a nearby point with the start policy and hold it, to measure the trim and check the policy.

    The point is 1 m ahead and 1 m to the side; at the surface or the floor it is also vertically away from it, because
    contact would carry the vehicle and falsify the trim.

    Args:
        env: the worlds.
        actor: the start policy.
        cost: the learner's running cost.
        seconds: duration, s.
        guard: guard between policy and thrusters.

    Returns:
        The flight, and tau_trim [L, 4], the mean control over the last quarter of the hover.

    Raises:
        InadmissiblePolicyError: the cost grew instead of falling.
    """
    start = env.start()
    steps = round(seconds / env.scenario.dt)
    quarter = steps // 4
    eta = start.vehicles.eta
    pose = eta.new_tensor([1.0, 1.0, 0.0, 0.0]).expand_as(eta)
    frame = LinkFrame.seen_as(eta, pose).within(env.scenario.depth)
    hovering = LinkController(frame, actor, actor.weight.new_zeros(4))
    trajectory = env.rollout(Guarded(hovering, guard), start, steps)
    running = cost.state(frame.relative(trajectory.states)).flatten(1)
    before, after = float(running[:quarter].mean()), float(running[-quarter:].mean())
    if not after < before:
        raise InadmissiblePolicyError(
            f"planner: the start policy is not admissible: holding a point 1.4 m away, its running cost grew from "
            f"{before:.3g} to {after:.3g} in {seconds:g} s; start from a damped policy (planner.start_gain > 0)"
        )
    return trajectory, trajectory.tau[-quarter:].double().mean(0).flatten(0, 1)
