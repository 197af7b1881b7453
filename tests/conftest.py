"""What every test shares: one torch thread, and configurations composed as the command line composes them."""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from functools import cache

import pytest
import torch

from uwirl import build
from uwirl.config.compose import compose
from uwirl.config.schema import Config
from uwirl.world.relay import Relay

MakeConfig = Callable[..., Config]


@pytest.fixture(scope="session", autouse=True)
def _one_thread() -> None:
    torch.set_num_threads(1)


@pytest.fixture(scope="session")
def make_config() -> MakeConfig:
    """make_config("channel=paper", ...): composed once for the session, copied for each call, not validated."""
    composed = cache(lambda *overrides: compose(overrides))
    return lambda *overrides: deepcopy(composed(*overrides))


@pytest.fixture(scope="session")
def make_relay(make_config: MakeConfig) -> Callable[..., Relay]:
    """make_relay("channel=paper", ..., streams=None): the environment of a configuration."""
    return lambda *overrides, streams=None: build.make_relay(make_config(*overrides), streams)
