"""Initial guesses for trajectory optimisation: flights along a path, or missions flown before."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from uwirl.motion.mission import Mission
from uwirl.motion.route import MapSettings, Router
from uwirl.motion.route_tracker import RouteTracker
from uwirl.motion.targets import ChainTargets
from uwirl.world.geometry import rotation_matrix, wrapped
from uwirl.world.relay import Relay
from uwirl.world.trajectory import Trajectory
from uwirl.world.vehicle import Vehicle

CORNER_S = 2.5  # length over which a guess rounds the corners of its path


class Guess(NamedTuple):
    """Start values of the solver: eta, nu and tau at the nodes, [N + 1, M, 4] each."""

    name: str
    eta: Tensor
    nu: Tensor
    tau: Tensor


def guess_along(
    env: Relay,
    targets: ChainTargets,
    paths: Sequence[Tensor],
    speed: float = 0.8,
    intervals: int = 200,
    turn: bool = False,
    world: int = 0,
    name: str = "path",
) -> Guess:
    """A flight along horizontal paths at constant speed, with rounded corners; the depth changes in proportion.

    Args:
        env: start, duration and vehicle.
        targets: target positions; their depths are used.
        paths: a polyline [K, 2] for each vehicle, m.
        speed: m/s.
        intervals: number of intervals N.
        turn: whether to turn bow or stern, whichever is nearer, along the path; otherwise keep the first heading.
        world: number of the world in the batch.
        name: name of the guess.
    """
    start = of_world(env.scenario.start, 2, world)
    depth = of_world(targets.frame.target, 2, world)[:, 2]
    h = env.scenario.duration / intervals
    travelled = speed * h * torch.arange(intervals + 1, dtype=start.dtype, device=start.device)
    flights = zip(paths, start, depth, strict=True)
    eta = torch.stack([_fly(path.to(start), pose, z, travelled, CORNER_S / h, turn) for path, pose, z in flights], 1)
    velocity = torch.gradient(eta, spacing=h, dim=0)[0]
    nu = (rotation_matrix(eta[..., 3]).mT @ velocity[..., None])[..., 0]
    assert isinstance(env.vehicle, Vehicle), "who plans with the model needs one"
    tau = (env.vehicle.damping_matrix(nu) @ nu[..., None])[..., 0] + env.vehicle.trim
    return Guess(name, eta, nu, env.vehicle.saturate(tau))


def _fly(path: Tensor, start: Tensor, depth: Tensor, travelled: Tensor, corner: float, turn: bool) -> Tensor:
    """eta [N + 1, 4] of a vehicle at distances [N + 1] along its path [K, 2]; `corner` is in nodes."""
    legs = path.diff(dim=0)
    arc = torch.nn.functional.pad(torch.linalg.vector_norm(legs, dim=-1).cumsum(0), (1, 0))
    z = torch.lerp(start[2], depth, (travelled / arc[-1].clamp_min(1e-9)).clamp_max(1.0))
    psi = start[3].expand_as(z)
    if turn:
        bearing = torch.cat([start[3:], torch.atan2(legs[:, 1], legs[:, 0])])
        turns = wrapped(bearing.diff(), math.pi)
        psi = (start[3] + turns.cumsum(0))[torch.searchsorted(arc, travelled).clamp(1, len(legs)) - 1]
    eta = torch.cat([interpolate(travelled, arc, path), z[:, None], psi[:, None]], -1)
    half = round(corner / 2.0)
    eta = torch.cat([eta[:1].expand(half, 4), eta, eta[-1:].expand(half, 4)]).unfold(0, 2 * half + 1, 1).mean(-1)
    return torch.cat([start[None], eta[1:]])


def guess_from(trajectory: Trajectory, world: int = 0, intervals: int = 200, name: str = "flight") -> Guess:
    """A flown mission, resampled at the nodes."""
    steps = trajectory.tau.shape[0]
    at = torch.linspace(0.0, steps, intervals + 1, dtype=torch.float64, device=trajectory.tau.device)
    x = interpolate(at, torch.arange(steps + 1).to(at), trajectory.components[..., world, :].double()).mT
    return Guess(name, x[..., :4], x[..., 4:], trajectory.tau[at.long().clamp_max(steps - 1), world].double())


def guesses_on_the_map(mission: Mission, speeds: Sequence[float], intervals: int, world: int = 0) -> list[Guess]:
    """Flights along the eikonal map at several speeds in m/s, with bow or stern ahead or with constant heading."""
    one = mission.env.select(torch.tensor([world], device=mission.env.streams.seed.device))
    router = Router(one.scenario, mission.targets.frame, mission.cost, 0.0, MapSettings(spacing_m=0.5))
    state, observation = one.reset()
    plan, position = RouteTracker(one.scenario, router).begin(observation).plan, state.vehicles.position
    paths = [plan.map.path(position[:, m : m + 1, :2].double())[m, 0] for m in range(one.scenario.vehicles)]
    return [
        guess_along(
            one, mission.targets, paths, speed, intervals, turn, name=f"map, {speed:g} m/s{', turned' if turn else ''}"
        )
        for speed in speeds
        for turn in (False, True)
    ]


def of_world(values: Tensor, dims: int, world: int) -> Tensor:
    """The values of one world, `dims`-dimensional, from values for each world [B, ...] or shared ones; float64."""
    while values.ndim > dims:
        values = values[world if len(values) > 1 else 0]
    return values.double()


def interpolate(at: Tensor, knots: Tensor, values: Tensor) -> Tensor:
    """Linear interpolation of values [K, ...] at increasing knots [K], constant beyond them; [n, ...] at points [n]."""
    right = torch.searchsorted(knots, at).clamp(1, len(knots) - 1)
    share = ((at - knots[right - 1]) / (knots[right] - knots[right - 1]).clamp_min(1e-12)).clamp(0.0, 1.0)
    return torch.lerp(values[right - 1], values[right], share.view(-1, *[1] * (values.ndim - 1)))
