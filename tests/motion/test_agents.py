"""The contract of every agent: pure, and all that it remembers is in its carry."""

import math
from collections.abc import Callable

import pytest
import torch
from trees import assert_same, copied, through_a_file

from uwirl import build
from uwirl.baselines.potential_field import Repelled
from uwirl.baselines.trajectory_optimization import Plan, PlanAgent
from uwirl.irl.networks import LinearActor
from uwirl.motion.features import LinkFrameBasis
from uwirl.motion.geodesic_basis import GeodesicBasis
from uwirl.motion.guidance import RouteCarry
from uwirl.motion.linear_agent import Excited, LinearAgent, LinkController
from uwirl.motion.mission import Mission
from uwirl.motion.route import MapSettings
from uwirl.motion.route_view import LearnedGeodesic
from uwirl.world.agent import Agent, Feedback, Guarded
from uwirl.world.random import RandomStreams

# Two vehicles in each of two worlds see Fig. 5's obstacles at 8 m, which drift, in a current that gusts.
WATERS = (
    "experiment=fig5_single",
    "scenario.start=[[29.5,29.5,0,1],[25.8,20.5,-3,2]]",
    "scenario.detection_range_m=8",
    "scenario.obstacles=[{center_m:[16,15],radius_m:2,influence_m:6,velocity_mps:[0.1,-0.2]},"
    "{center_m:[22,28],radius_m:1,influence_m:5}]",
    "scenario.current_mps=[0.05,0.02,0]",
    "scenario.current_std_mps=0.02",
    "guidance.spacing_m=1",
)
ONE_OBSTACLE = "scenario.obstacles=[{center_m:[16,15],radius_m:2,influence_m:6}]"
# Every so many steps obstacles are looked for.
STEPS, LOOKS = 100, 10


@pytest.fixture
def mission(make_mission) -> Mission:
    return make_mission(*WATERS, streams=RandomStreams.worlds(0, 2))


def link_controller(mission: Mission) -> LinkController:
    basis = LinkFrameBasis(mission.cost, [2.0, math.inf])
    actor = LinearActor(basis, basis.start_weights()[None])
    return LinkController(mission.targets.frame, actor, mission.env.vehicle.trim.double())


def linear(mission: Mission, excited: bool) -> Agent:
    near = link_controller(mission)
    random = torch.Generator().manual_seed(0)
    wave = 5.0 * torch.randn(STEPS, 2, 2, 4, generator=random, dtype=torch.float64)
    agent = LinearAgent(near.actor.basis.view(mission.env, near.frame), near.actor, near.trim)
    return Excited(agent, wave, 0) if excited else agent


WAYS = LearnedGeodesic(0.1, MapSettings(spacing_m=1.0))


def of_the_way(mission: Mission) -> LinkController:
    basis = GeodesicBasis(mission.cost, [2.0, math.inf], WAYS)
    return LinkController(
        mission.targets.frame, LinearActor(basis, basis.start_weights()[None]), mission.env.vehicle.trim.double()
    )


def sees_its_way(mission: Mission) -> LinearAgent:
    near = of_the_way(mission)
    return LinearAgent(near.actor.basis.view(mission.env, near.frame), near.actor, near.trim)


def plan_agent(mission: Mission) -> PlanAgent:
    """A straight plan to the targets."""
    start = mission.env.scenario.start
    end = torch.cat([mission.targets.frame.target, mission.targets.frame.bearing[:, None]], -1)
    share = torch.linspace(0.0, 1.0, 21, dtype=torch.float64)[:, None, None]
    still = torch.zeros(21, 2, 4, dtype=torch.float64)
    return PlanAgent(mission.env, Plan(start + share * (end - start), still, still, 0.0, True, "straight", ()))


@pytest.fixture
def geodesic(make_config) -> Callable[[Mission], Agent]:
    return lambda mission: build.make_guidance(make_config(*WATERS))(mission)(link_controller(mission))


NAMES = ["link controller", "linear", "excited", "of the way", "geodesic", "route", "plan", "repelled", "feedback"]


@pytest.fixture(params=[*NAMES, "guarded"])
def make_agent(request, make_config, geodesic) -> Callable[[Mission], Agent]:
    """Made anew for each mission."""

    def guarded(mission: Mission) -> Agent:
        return Guarded(geodesic(mission), build.make_guard(make_config(*WATERS), mission.env))

    return {
        "link controller": link_controller,
        "linear": lambda mission: linear(mission, excited=False),
        "excited": lambda mission: linear(mission, excited=True),
        "of the way": sees_its_way,
        "geodesic": geodesic,
        "route": lambda mission: WAYS(mission)(of_the_way(mission)),
        "plan": plan_agent,
        "repelled": lambda mission: Repelled(link_controller(mission), 40.0, 5.0, 0.3),
        "feedback": lambda mission: Feedback(lambda observation: -20.0 * observation.nu + 3.0),
        "guarded": guarded,
    }[request.param]


def test_the_same_call_twice_gives_the_same_and_changes_nothing(mission, make_agent):
    """Whenever it looks for obstacles: sometimes it finds one, or plans anew."""
    agent, (state, observation) = make_agent(mission), mission.env.reset()
    assert_same(agent.init(observation), agent.init(observation))
    carry = agent.init(observation)
    for step in range(STEPS):
        given = carry, observation
        before = copied(given)
        tau, carry = agent.act(*given)
        if step % LOOKS == 0:
            assert_same(agent.act(*given), (tau, carry))
            assert_same(given, before)
        state, observation = mission.env.step(state, tau, getattr(carry, "target", None))


@pytest.mark.parametrize("stop", [37, 6 * LOOKS])
def test_a_flight_goes_on_as_if_it_had_never_stopped(mission, make_mission, make_agent, tmp_path, stop):
    """From a file, by another object in other worlds of the same configuration."""
    whole = mission.env.rollout(make_agent(mission), steps=STEPS)
    first = mission.env.rollout(make_agent(mission), steps=stop)
    end, carry = through_a_file((first.end, first.carry), tmp_path / "flight.pt")
    again = make_mission(*WATERS, streams=RandomStreams.worlds(0, 2))
    rest = again.env.rollout(make_agent(again), end, STEPS - stop, carry)
    assert rest.first_step == stop
    assert_same((rest.components, rest.tau), (whole.components[stop:], whole.tau[stop:]))
    assert_same((rest.end, rest.carry), (whole.end, whole.carry))


def test_what_those_flights_remember_changes(mission, geodesic):
    """Or they would prove nothing: obstacles are found, others are planned past anew, and the current is pushed."""
    agent = geodesic(mission)
    carry: RouteCarry = agent.init(mission.env.reset()[1])
    flown = mission.env.rollout(agent, steps=STEPS).carry
    assert int(flown.route.obstacles.present.sum()) > int(carry.route.obstacles.present.sum())
    assert not torch.equal(flown.route.plan.map.value, carry.route.plan.map.value)
    assert bool(flown.push.any())


@pytest.mark.parametrize("known", [True, False])
@pytest.mark.parametrize(
    ("theirs", "worlds", "remembered"),
    [
        ((), 3, "3 worlds, 2 vehicles and 2 obstacles"),
        (("scenario.start=[[29.5,29.5,0,1]]",), 2, "2 worlds, 1 vehicles and 2 obstacles"),
        ((ONE_OBSTACLE,), 2, "2 worlds, 2 vehicles and 1 obstacles"),
    ],
    ids=["worlds", "vehicles", "obstacles"],
)
def test_a_carry_of_another_flight_is_refused(make_mission, geodesic, known, theirs, worlds, remembered):
    overrides = (*WATERS, "scenario.detection_range_m=inf") if known else WATERS
    elsewhere = make_mission(*overrides, *theirs, streams=RandomStreams.worlds(0, worlds))
    here = make_mission(*overrides, streams=RandomStreams.worlds(0, 2))
    for agent_in in (geodesic, lambda mission: WAYS(mission)(of_the_way(mission))):
        carry = agent_in(elsewhere).init(elsewhere.env.reset()[1])
        with pytest.raises(
            ValueError, match=f"carry is of {remembered}, the observation of 2 worlds, 2 vehicles and 2"
        ):
            here.env.rollout(agent_in(here), steps=1, carry=carry)
