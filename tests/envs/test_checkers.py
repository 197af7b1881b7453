"""The checkers of the libraries whose interfaces the environments have; a warning of theirs is an error here."""

from __future__ import annotations

from collections.abc import Callable

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from pettingzoo.test import parallel_api_test, parallel_seed_test

from uwirl.envs import RelayEnv, RelayParallelEnv

RELAY = "uwirl.envs:uwirl/Relay-v0"
PAIR = ["experiment=fig6_pair", "scenario.duration_s=5"]
OPTIONS = {
    "one vehicle": {},
    "two vehicles": {"overrides": PAIR},
    "shadowed": {"overrides": ["channel=acoustic_24khz", "scenario.duration_s=5"]},
    "guarded": {"guard": "energy", "random_start": True, "ends_on_contact": True},
    "noisy": {"overrides": ["dtype=float32", "scenario.detection_range_m=8", "scenario.current_std_mps=0.1"]},
}
each = pytest.mark.parametrize("options", OPTIONS.values(), ids=list(OPTIONS))


@each
def test_gymnasium_checks_the_single_environment(options: dict):
    check_env(gymnasium.make(RELAY, **options).unwrapped)


@each
def test_stable_baselines_checks_the_single_environment(options: dict):
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    checker.check_env(gymnasium.make(RELAY, render_mode="rgb_array", **options).unwrapped, skip_render_check=False)


@pytest.fixture(params=["two vehicles", "guarded"])
def parallel(request) -> Callable[[], RelayParallelEnv]:
    return lambda: RelayParallelEnv(**OPTIONS[request.param])


def test_pettingzoo_checks_the_parallel_environment(parallel):
    parallel_api_test(parallel(), num_cycles=200)
    parallel_seed_test(parallel)


def test_parallel_episodes_of_one_seed_are_the_same(parallel):
    # parallel_seed_test of PettingZoo 1.27 stops after one step, because `any` of a dictionary looks at its keys.
    def flown(env: RelayParallelEnv) -> list:
        seen: list = [env.reset(seed=7), env.reset()]
        for k in range(8):
            actions = {agent: np.full(4, 0.1 * (k + i), dtype=np.float32) for i, agent in enumerate(env.agents)}
            seen.append(env.step(actions))
        return seen

    for one, other in zip(flown(parallel()), flown(parallel()), strict=True):
        np.testing.assert_equal(one, other)


@pytest.mark.parametrize("mode", ["NextStep", "SameStep", "Disabled"])
def test_the_registered_vector_environment_declares_its_autoreset(mode: str):
    env = gymnasium.make_vec(RELAY, num_envs=3, autoreset_mode=mode)
    assert env.metadata["autoreset_mode"].value == mode
    assert env.observation_space.shape == (3, *env.single_observation_space.shape)
    observations, _ = env.reset(seed=0)
    assert observations in env.observation_space


def test_all_spaces_have_finite_bounds_and_are_float32():
    env = RelayEnv(overrides=PAIR)
    for space in (env.observation_space, env.action_space):
        assert space.dtype == np.float32
        assert space.is_bounded("both")
        assert np.isfinite(space.high).all()
