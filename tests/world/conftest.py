"""Two vehicles between the paper's nodes, in several worlds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from uwirl.world.random import RandomStreams
from uwirl.world.relay import Relay

WORLDS = 5
START = "scenario.start=[[-12,-9,-7,0.5],[10,11,-6,-1]]"
MakePair = Callable[..., Relay]


@pytest.fixture
def make_pair(make_relay) -> MakePair:
    """make_pair("channel=paper", ..., worlds=5, depth=12.0): overrides, then fields of the scenario by value."""

    def made(*overrides: str, worlds: int = WORLDS, **fields: Any) -> Relay:
        env = make_relay(START, *overrides, streams=RandomStreams.worlds(11, worlds))
        return env.on(replace(env.scenario, **fields), env.streams)

    return made


@pytest.fixture
def env(make_pair: MakePair) -> Relay:
    return make_pair()
