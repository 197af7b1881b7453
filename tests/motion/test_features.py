"""Contract of every basis, and what the link-frame basis promises."""

import math

import pytest
import torch

from uwirl.irl.networks import LinearActor
from uwirl.motion.features import ErrorBasis, LinkFrameBasis

INERTIA_LOWER, DT = (12.0, 12.0, 12.0, 0.2), 0.05


@pytest.fixture
def cost(make_mission):
    return make_mission().cost


@pytest.fixture(params=["link_frame", "one_scale", "linear", "error_quadratic", "error_velocity"])
def basis(request, cost):
    return {
        "link_frame": lambda: LinkFrameBasis(cost, [2.0, math.inf]),
        "one_scale": lambda: LinkFrameBasis(cost, [4.0]),
        "linear": lambda: LinkFrameBasis(cost, [math.inf]),
        "error_quadratic": lambda: ErrorBasis(velocity=False),
        "error_velocity": lambda: ErrorBasis(velocity=True),
    }[request.param]()


def states(count: int = 64) -> torch.Tensor:
    scale = torch.tensor([20.0, 10.0, 5.0, 2.0, 1.0, 0.5, 0.3, 0.5], dtype=torch.float64)
    return scale * torch.randn(count, 1, 8, generator=torch.Generator().manual_seed(0), dtype=torch.float64)


def test_features_have_their_names(basis):
    xi = states()
    assert basis.critic(xi).shape == (64, 1, len(basis.critic_names))
    assert basis.actor(xi).shape == (64, 1, sum(len(names) for names in basis.actor_names))
    assert len(basis.actor_names) == 4


def test_all_features_vanish_at_rest_at_the_target(basis):
    rest = torch.zeros(1, 1, 8, dtype=torch.float64)
    torch.testing.assert_close(basis.critic(rest), torch.zeros_like(basis.critic(rest)), rtol=0, atol=1e-15)
    torch.testing.assert_close(basis.actor(rest), torch.zeros_like(basis.actor(rest)), rtol=0, atol=1e-15)


def test_start_policy_lies_within_the_bounds(basis):
    start, bounds = basis.start_weights(), basis.bounds(INERTIA_LOWER, DT)
    assert (bounds.lower <= start).all()
    assert (start <= bounds.upper).all()
    assert (bounds.lower < bounds.upper).all()


def test_start_policy_pushes_towards_the_target(basis):
    """In each axis, from rest: work done on the way to the target is positive."""
    actor = LinearActor(basis, basis.start_weights()[None])
    for axis in range(4):
        xi = torch.zeros(1, 1, 8, dtype=torch.float64)
        xi[..., axis] = 0.8
        assert float(actor(xi)[..., axis]) < 0.0


def test_mirror_image_gives_the_mirrored_control(basis):
    """Across, yaw and their rates change sign: so do sway and yaw control, and no critic feature."""
    mirror = torch.tensor([1.0, -1.0, 1.0, -1.0, 1.0, -1.0, 1.0, -1.0], dtype=torch.float64)
    actor = LinearActor(basis, basis.start_weights()[None])
    xi = states()
    control_mirror = torch.tensor([1.0, -1.0, 1.0, -1.0], dtype=torch.float64)
    torch.testing.assert_close(actor(mirror * xi), control_mirror * actor(xi))
    torch.testing.assert_close(basis.critic(mirror * xi), basis.critic(xi))


@pytest.mark.parametrize("L", [0.5, 2.0, math.inf])
def test_saturated_error_is_the_slope_of_its_integral(cost, L):
    error = torch.linspace(-10.0, 10.0, 41, dtype=torch.float64).requires_grad_()
    g, G = LinkFrameBasis(cost, [L]).saturated(error, L)
    (slope,) = torch.autograd.grad(G.sum(), error)
    factor = 2.0 if math.isinf(L) else 1.0
    torch.testing.assert_close(slope, factor * g.detach())
    assert float(g.detach().abs().max()) <= L


def test_planar_control_does_not_depend_on_heading(cost):
    """With equal surge and sway weights the force in the link frame is the same whatever the heading."""
    basis = LinkFrameBasis(cost, [2.0, math.inf])
    weight = torch.zeros(1, 17, dtype=torch.float64)
    weight[:, [0, 1, 5, 6]] = -7.0
    actor = LinearActor(basis, weight)
    xi = torch.zeros(8, 1, 8, dtype=torch.float64)
    xi[..., 0], xi[..., 1] = 3.0, -1.5
    xi[:, 0, 3] = torch.linspace(0.0, 6.0, 8)
    force = actor(xi)[:, 0]
    c, s = torch.cos(xi[:, 0, 3]), torch.sin(xi[:, 0, 3])
    along = c * force[:, 0] - s * force[:, 1]
    across = s * force[:, 0] + c * force[:, 1]
    for component, error in ((along, 3.0), (across, -1.5)):
        expected = -7.0 * error / math.sqrt(1.0 + (error / 2.0) ** 2)
        torch.testing.assert_close(component, torch.full_like(component, expected))
