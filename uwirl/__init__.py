"""Integral reinforcement learning for underwater vehicles that relay data over a fading acoustic channel.

The names that a notebook needs, each imported when it is first used. The parts: `uwirl.world` (vehicles, channel,
obstacles, observations), `uwirl.snr` (from readings to the channel), `uwirl.irl` (the learner, which knows no water),
`uwirl.motion` and `uwirl.baselines` (planners and agents), `uwirl.study` (judging), `uwirl.envs` (other people's
algorithms), `uwirl.algorithm` (Algorithm 1).
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from uwirl.algorithm import algorithm_1
    from uwirl.baselines.pd import PdPlanner
    from uwirl.motion.cost import CostWeights
    from uwirl.motion.guidance import Geodesic
    from uwirl.motion.identified_planner import IdentifiedPlanner
    from uwirl.motion.irl_planner import IrlPlanner
    from uwirl.motion.mission import Mission
    from uwirl.motion.safety import EnergyGuard, Limits
    from uwirl.snr.estimate import ChannelEstimate
    from uwirl.snr.estimators import maximum_likelihood
    from uwirl.snr.kriging import Kriging
    from uwirl.study.evaluation import Evaluation, Evaluator
    from uwirl.study.survey import Survey
    from uwirl.world.acoustics import Channel, LinkBudget
    from uwirl.world.agent import Agent, Feedback, Guarded
    from uwirl.world.observation import Observation
    from uwirl.world.obstacles import Obstacles
    from uwirl.world.random import RandomStreams
    from uwirl.world.readings import Readings, take_readings
    from uwirl.world.relay import Relay
    from uwirl.world.scenario import Scenario
    from uwirl.world.trajectory import Trajectory, WorldState
    from uwirl.world.vehicle import Vehicle

__version__ = "0.1.0"

_HOMES = {
    "algorithm": ["algorithm_1"],
    "baselines.pd": ["PdPlanner"],
    "motion.cost": ["CostWeights"],
    "motion.guidance": ["Geodesic"],
    "motion.identified_planner": ["IdentifiedPlanner"],
    "motion.irl_planner": ["IrlPlanner"],
    "motion.mission": ["Mission"],
    "motion.safety": ["EnergyGuard", "Limits"],
    "snr.estimate": ["ChannelEstimate"],
    "snr.estimators": ["maximum_likelihood"],
    "snr.kriging": ["Kriging"],
    "study.evaluation": ["Evaluation", "Evaluator"],
    "study.survey": ["Survey"],
    "world.acoustics": ["Channel", "LinkBudget"],
    "world.agent": ["Agent", "Feedback", "Guarded"],
    "world.readings": ["Readings", "take_readings"],
    "world.observation": ["Observation"],
    "world.obstacles": ["Obstacles"],
    "world.random": ["RandomStreams"],
    "world.relay": ["Relay"],
    "world.trajectory": ["Trajectory", "WorldState"],
    "world.scenario": ["Scenario"],
    "world.vehicle": ["Vehicle"],
}
_HOME = {name: f"uwirl.{home}" for home, names in _HOMES.items() for name in names}

__all__ = [
    "Agent",
    "Channel",
    "ChannelEstimate",
    "CostWeights",
    "EnergyGuard",
    "Evaluation",
    "Evaluator",
    "Feedback",
    "Geodesic",
    "Guarded",
    "IdentifiedPlanner",
    "IrlPlanner",
    "Kriging",
    "Limits",
    "LinkBudget",
    "Mission",
    "Observation",
    "Obstacles",
    "PdPlanner",
    "RandomStreams",
    "Readings",
    "Relay",
    "Scenario",
    "Survey",
    "Trajectory",
    "Vehicle",
    "WorldState",
    "__version__",
    "algorithm_1",
    "maximum_likelihood",
    "take_readings",
]


def __getattr__(name: str) -> Any:
    # Late, because a typo on the command line is answered before torch is loaded.
    if name not in _HOME:
        raise AttributeError(f"module 'uwirl' has no attribute {name!r}")
    return getattr(import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    return __all__
