"""What runs at every step works on any device, without tensors of two: on fake tensors, because CI has no GPU.

Objects are made on the CPU and sent to the device `meta`, whose tensors have no values. A constant that is made on the
CPU by mistake then meets them, which fake tensors refuse; so is a question that a GPU would have to be waited for.
"""

import io
from typing import Any

import pytest
import torch
from torch._subclasses import FakeTensorMode
from torch._subclasses.fake_tensor import FakeTensorDeviceMismatchError

from uwirl import build
from uwirl.snr.estimators import oracle
from uwirl.world.readings import take_readings
from uwirl.world.truth import truth_of

EXPERIMENTS = {
    "free": ("experiment=fig5_free",),
    "obstacles": ("experiment=fig5_single",),
    "barrier": ("experiment=fig5_single", "safety=barrier"),
    "pair, navigation, current": (
        "experiment=fig6_pair",
        "scenario.navigation.position_m=0.1",
        "scenario.current_mps=[0.1,0.0,0.0]",
        "scenario.current_std_mps=0.05",
    ),
    "single precision": ("experiment=fig5_single", "dtype=float32"),
}


def sent(*objects: Any) -> Any:
    """The same objects with all tensors on the device `meta`."""
    memory = io.BytesIO()
    torch.save(objects, memory)
    memory.seek(0)
    return torch.load(memory, map_location="meta", weights_only=False)


def test_two_devices_are_noticed():
    (there,) = sent(torch.zeros(3))
    with FakeTensorMode(allow_non_fake_inputs=True), pytest.raises(FakeTensorDeviceMismatchError):
        there + torch.ones(3)


@pytest.mark.parametrize("overrides", EXPERIMENTS.values(), ids=EXPERIMENTS)
def test_a_control_step(make_config, make_relay, overrides):
    """Law, guard, world and observation."""
    config, env = make_config(*overrides), make_relay(*overrides)
    truth = oracle(take_readings(env), env.budget, truth_of(env).channel)
    agent = build.make_planner(config, config.baseline, env).fit(env, truth)
    state, observation = env.reset()
    carry = agent.init(observation)
    env, agent, guard, state, carry, observation = sent(
        env, agent, build.make_guard(config, env), state, carry, observation
    )
    with FakeTensorMode(allow_non_fake_inputs=True):
        tau, carry = agent.act(carry, observation)
        state, observation = env.step(state, guard(tau, observation), getattr(carry, "target", None))
    assert {x.device.type for x in (tau, state.components, *observation.obstacles, observation.eta)} == {"meta"}
