"""Whether a free path exists between two points among cylinders: exact, without a grid.

Discs separate p from q in the plane if and only if their union contains a closed curve that the segment pq crosses an
odd number of times (Alexander duality, modulo 2). Two overlapping discs contain the segment between their centres, and
any closed curve in the union can be deformed into a walk along such segments (nerve theorem). This gives a graph: discs
are vertices, overlaps are edges, an edge is odd if its segment crosses pq, and p and q are separated if some cycle has
an odd number of odd edges (S. Cabello, P. Giannopoulos, "The complexity of separating points in the plane", 2016).
No cycle has one if and only if the vertices can be given parities whose difference along every edge is that of the edge
(F. Harary, "On the notion of balance of a signed graph", 1953).
"""

from __future__ import annotations

import torch
from torch import Tensor

from uwirl.world.obstacles import Obstacles

# Pairs of discs processed together: 8 MB for each number stored per pair.
BLOCK = 1 << 20


def separated(obstacles: Obstacles, inflation: float | Tensor, p: Tensor, q: Tensor) -> Tensor:
    """Whether there is no path from p to q outside all present discs, which are open with radius rho_m + inflation.

    A point inside a disc is separated from every point, even itself. Drifting obstacles are used at time 0.

    Args:
        obstacles: fields [..., O(, 2)], broadcast against the points.
        inflation: vehicle radius plus margin, a number or [..., 1], m.
        p: [..., 2], m.
        q: [..., 2], m.

    Returns:
        bool [...]
    """
    lead = torch.broadcast_shapes(
        p.shape[:-1],
        q.shape[:-1],
        obstacles.centre.shape[:-2],
        obstacles.radius.shape[:-1],
        obstacles.present.shape[:-1],
    )
    count = obstacles.number
    if count == 0:
        return torch.zeros(lead, dtype=torch.bool, device=p.device)
    tensors = (
        _rows(obstacles.centre, lead, 2),
        _rows(obstacles.radius + inflation, lead, 1),
        _rows(obstacles.present, lead, 1),
        _rows(p[..., None, :], lead, 2),
        _rows(q[..., None, :], lead, 2),
    )
    rows = max(1, BLOCK // count**2)
    blocks = (
        [tensor if len(tensor) == 1 else tensor[first : first + rows] for tensor in tensors]
        for first in range(0, max(1, lead.numel()), rows)
    )
    return torch.cat([_separated(*block) for block in blocks]).view(lead)


def _rows(tensor: Tensor, lead: torch.Size, trailing: int) -> Tensor:
    """Flatten leading dimensions to [n, ...], or [1, ...] if the values are shared; keep the last `trailing` ones."""
    own = tensor.shape[-trailing:]
    if tensor.numel() == own.numel():
        return tensor.reshape(1, *own)
    return tensor.expand(*lead, *own).reshape(-1, *own)


def _separated(centre: Tensor, radius: Tensor, present: Tensor, p: Tensor, q: Tensor) -> Tensor:
    """`separated` for discs [n, O(, 2)] and points [n, 1, 2], bool [n]."""
    from_p, from_q = centre - p, centre - q
    inside = [torch.linalg.vector_norm(offset, dim=-1) < radius for offset in (from_p, from_q)]
    edge = torch.linalg.vector_norm(centre[:, :, None] - centre[:, None], dim=-1) < radius[:, :, None] + radius[:, None]
    edge = edge & present[:, :, None] & present[:, None]
    odd = edge & _crosses(from_p, from_q)
    parity = _walk_parity(edge, odd)
    unbalanced = edge & (parity[:, :, None] ^ parity[:, None] ^ odd)
    return ((inside[0] | inside[1]) & present).any(-1) | unbalanced.flatten(1).any(-1)


def _cross(a: Tensor, b: Tensor) -> Tensor:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def _crosses(from_p: Tensor, from_q: Tensor) -> Tensor:
    """Whether the segment between two centres crosses pq, [n, O, O]; centres relative to p and to q, [n, O, 2]."""
    # A centre on the line pq counts as left of it, for all its edges: as if it were moved by an infinitesimal amount.
    left = _cross(from_p - from_q, from_p) >= 0.0
    # p and q are on different sides of the line through the centres. If one is on the segment, it is inside a disc.
    p_side, q_side = (_cross(offset[:, :, None], offset[:, None]) > 0.0 for offset in (from_p, from_q))
    return (left[:, :, None] ^ left[:, None]) & (p_side ^ q_side)


def _walk_parity(edge: Tensor, odd: Tensor) -> Tensor:
    """Parity of the number of odd edges on a walk to each disc from the first disc of its cluster, [n, O], bool."""
    count = edge.shape[-1]
    first = torch.arange(count, dtype=torch.int32, device=edge.device).expand(edge.shape[:-1])
    parity = torch.zeros(odd.shape[:-1], dtype=torch.bool, device=odd.device)
    while True:
        earliest, via = torch.where(edge, first[:, None], count).min(-1)
        if torch.equal(earliest, first):
            return parity
        via = via.expand(parity.shape)
        first, parity = earliest, parity.gather(-1, via) ^ odd.gather(-1, via[..., None])[..., 0]
