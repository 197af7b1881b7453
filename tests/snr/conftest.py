"""The shipped channels."""

from __future__ import annotations

import pytest

from uwirl import build
from uwirl.config.compose import folder
from uwirl.world.acoustics import Channel

CHANNELS = sorted(path.stem for path in (folder() / "channel").glob("*.yaml"))


@pytest.fixture(params=CHANNELS)
def channel(request: pytest.FixtureRequest, make_config) -> Channel:
    return build.make_channel(make_config(f"channel={request.param}").channel)


@pytest.fixture
def paper(make_config) -> Channel:
    """Almost no fading."""
    return build.make_channel(make_config("channel=paper").channel)


@pytest.fixture
def acoustic(make_config) -> Channel:
    """zeta = 3 dB, varphi = 15 m, rho = 1 dB."""
    return build.make_channel(make_config("channel=acoustic_24khz").channel)
