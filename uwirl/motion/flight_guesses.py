"""Where planned flights begin: along the ways on the map, at the pace that the learned drag asks for.

The pace at a place of cost rate q minimises (q + R_u F(v)^2) / v, with F(v) the drag of going ahead. Guesses are shares
of it, slower in the first metres, because turning is cheap at rest; the heading is the link's bearing, or that of bow
or stern along the way, whichever is nearer.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from uwirl.motion.flight_plan import FlightProblem
from uwirl.motion.vehicle_model import VehicleModel
from uwirl.world.geometry import length, turned_to_body, wrapped

# Share of the best pace at the start and later on, and the way over which the first becomes the second, m.
PACES, PICK_UP = ((0.6, 0.6), (0.2, 0.7), (0.1, 0.4)), 4.0
HEADINGS = 2
# All arrive within this share of the plan.
ARRIVE = 0.6
FASTEST, SPEEDS = 3.0, 120  # m/s, and how many are tried
# Time over which corners are rounded, s.
CORNER = 2.0
# Distance from the goal whose cost rate is the least that sets the pace, m.
NEAR = 1.5


def guesses(problem: FlightProblem, start: Tensor, paths: Tensor, depth: Tensor, nodes: int) -> tuple[Tensor, Tensor]:
    """Flights along ways: each pace with each heading.

    Args:
        problem: K flights.
        start: x_0, [K, 8].
        paths: polylines from start to goal, [K, P, 2], m.
        depth: z of the goals, [K], m.
        nodes: N + 1.

    Returns:
        x [N + 1, K G, 8] and effort [N, K G, 4]; the G guesses of a flight follow each other.
    """
    cost, dt = problem.cost, problem.cost.dt
    legs = paths.diff(dim=1)
    arc = torch.nn.functional.pad(length(legs).cumsum(-1), (1, 0))
    whole = arc[:, -1:].clamp_min(1e-6)
    z = torch.lerp(start[:, 2:3], depth[:, None], arc / whole)
    way = torch.cat([paths, z[..., None]], -1)
    q = cost.rate_at(way)
    q = (q - q[:, -1:]).clamp_min(0.0)
    left = whole - arc
    least = q.gather(-1, (left - NEAR).abs().argmin(-1, keepdim=True)).clamp_min(1e-4)
    speed = _pace(problem.model, cost.cost.R.to(q), torch.maximum(q, least))
    takes = torch.nn.functional.pad((arc.diff() / (0.5 * (speed[:, 1:] + speed[:, :-1]))).cumsum(-1), (1, 0))
    flights = []
    time = dt * torch.arange(nodes, dtype=arc.dtype, device=arc.device)
    for first, then in PACES:
        enough = (takes[:, -1:] / (ARRIVE * time[-1])).clamp(then, 1.0)
        share = enough + (first - enough).clamp_max(0.0) * torch.exp(-arc / PICK_UP)
        middle = 0.5 * (share[:, 1:] + share[:, :-1])
        at = torch.nn.functional.pad((takes.diff() / middle).cumsum(-1), (1, 0))
        position, bearing, arrived = _followed(time, at, way)
        for heading in range(HEADINGS):
            psi = _heading(start[:, 3], cost.frame.bearing, bearing, arrived) if heading else None
            flights.append(_flight(problem, start, position, psi))
    G = len(flights)
    x = torch.stack(flights, 2).flatten(1, 2)
    rows = torch.arange(len(start), device=start.device).repeat_interleave(G)
    return x, _effort(problem.model.select(rows), x, dt)


def _pace(model: VehicleModel, R: Tensor, q: Tensor) -> Tensor:
    """Speed ahead that minimises the cost per metre, [K, P], m/s."""
    v = torch.linspace(FASTEST / SPEEDS, FASTEST, SPEEDS, dtype=q.dtype, device=q.device)
    ahead = torch.nn.functional.pad(v[:, None, None].expand(-1, len(q), 1), (0, 3))
    drag = (model.forces(ahead) - model.trim)[..., 0].T  # [K, speeds]
    per_metre = (q[..., None] + (R[0] * drag.square())[:, None]) / v
    return v[per_metre.argmin(-1)]


def _followed(time: Tensor, at: Tensor, path: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Positions [N + 1, K, 3], bearings of the way [N + 1, K], and whether it has ended [N + 1, K].

    Args:
        time: of the nodes, [N + 1], s.
        at: when each point of the path is reached, [K, P], s.
        path: [K, P, 3].
    """
    when = time.expand(len(path), -1).contiguous()
    right = torch.searchsorted(at.contiguous(), when).clamp(1, at.shape[1] - 1)
    t0, t1 = at.gather(1, right - 1), at.gather(1, right)
    share = ((when - t0) / (t1 - t0).clamp_min(1e-9)).clamp(0.0, 1.0)[..., None]

    def take(index: Tensor) -> Tensor:
        return path.gather(1, index[..., None].expand(-1, -1, 3))

    position = torch.lerp(take(right - 1), take(right), share)
    leg = path.diff(dim=1)
    bearing = torch.atan2(leg[..., 1], leg[..., 0])
    # Ways of a batch end with legs of no length.
    last = (length(leg[..., :2]) > 1e-6).sum(-1, keepdim=True).clamp_min(1) - 1
    along = bearing.gather(1, torch.minimum(right - 1, last))
    return position.transpose(0, 1), along.T, (when > at[:, -1:]).T


def _heading(psi: Tensor, link: Tensor, along: Tensor, arrived: Tensor) -> Tensor:
    """psi [N + 1, K] with bow or stern along the way, and the link's bearing at its end."""
    first = link + wrapped(along[0] - link, math.pi)
    first = psi + wrapped(first - psi)
    turned = first + torch.cat([torch.zeros_like(along[:1]), wrapped(along.diff(dim=0), math.pi).cumsum(0)])
    return torch.where(arrived, turned[-1] + wrapped(link - turned[-1]), turned)


def _flight(problem: FlightProblem, start: Tensor, position: Tensor, psi: Tensor | None) -> Tensor:
    """x [N + 1, K, 8] over positions [N + 1, K, 3], with rounded corners; the link's bearing where psi is None."""
    dt, link = problem.cost.dt, problem.cost.frame.bearing
    half = round(CORNER / 2.0 / dt)
    if psi is None:
        psi = (start[:, 3] + wrapped(link - start[:, 3])).expand(len(position), -1)
    else:
        psi = _smooth(psi[..., None], 2 * half)[..., 0]
    position = _smooth(position, half)
    turn = start[:, 3] - psi[0]
    time = dt * torch.arange(len(position), dtype=position.dtype, device=position.device)[:, None]
    done = (time / (2.0 + 2.0 * turn.abs())).clamp_max(1.0)
    psi = psi + 0.5 * turn * (1.0 + torch.cos(math.pi * done))
    pose = torch.cat([position, psi[..., None]], -1)
    rate = torch.gradient(pose, spacing=dt, dim=0)[0]
    rate = torch.cat([rate[..., :2] - problem.model.current, rate[..., 2:]], -1)
    return torch.cat([pose, turned_to_body(rate, psi)], -1)


def _smooth(values: Tensor, half: int) -> Tensor:
    """Moving average of values [n, ...] over 2 half + 1 nodes, the ends repeated."""
    if not half:
        return values
    padded = torch.cat(
        [values[:1].expand(half, *values.shape[1:]), values, values[-1:].expand(half, *values.shape[1:])]
    )
    return padded.unfold(0, 2 * half + 1, 1).mean(-1)


def _effort(model: VehicleModel, x: Tensor, dt: float) -> Tensor:
    """Effort [N, K, 4] that flights x [N + 1, K, 8] take by the model."""
    nu = 0.5 * (x[1:, :, 4:] + x[:-1, :, 4:])
    change = (x[1:, :, 4:] - x[:-1, :, 4:]) / dt
    inertia = torch.linalg.inv(model.inverse_inertia)
    return (inertia @ change[..., None])[..., 0] + model.forces(nu) - model.trim
