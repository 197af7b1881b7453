"""Whoever builds from code gets what the configuration gives."""

from collections.abc import Sequence
from dataclasses import fields

from uwirl import build
from uwirl.motion.cost import CostWeights
from uwirl.motion.route import MapSettings
from uwirl.motion.way_law import WayLaw


def values(settings: object) -> dict:
    """By name; a list is as good as a tuple."""
    found = {field.name: getattr(settings, field.name) for field in fields(settings)}
    return {name: list(value) if isinstance(value, Sequence) else value for name, value in found.items()}


def test_defaults_are_those_of_the_configuration(make_config):
    config = make_config("guidance=geodesic")
    guidance = build.make_guidance(config)
    assert values(CostWeights()) == values(build.make_cost(config.cost))
    assert values(WayLaw()) == values(guidance.law)
    assert values(MapSettings(config.guidance.spacing_m)) == values(guidance.map_settings)
