"""The one place where names in a configuration become objects."""

from uwirl.builders.estimators import make_estimator
from uwirl.builders.motion import make_cost, make_evaluator, make_guard, make_guidance
from uwirl.builders.planners import make_planner
from uwirl.builders.worlds import make_channel, make_layouts, make_relay, make_scenario

__all__ = [
    "make_channel",
    "make_cost",
    "make_estimator",
    "make_evaluator",
    "make_guard",
    "make_guidance",
    "make_layouts",
    "make_planner",
    "make_relay",
    "make_scenario",
]
