"""The vector environment: Gymnasium's own loop over single ones says what it must return."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers.vector import DictInfoToList, RecordEpisodeStatistics

from uwirl.envs import RelayEnv, RelayVectorEnv, make_task

# Some hit the obstacle at once, others are truncated.
NEAR = "scenario.obstacles=[{center_m:[27.5,27.5],radius_m:1.5,influence_m:6}]"
CASES: dict[str, dict[str, Any]] = {
    "contacts": {"overrides": [NEAR, "scenario.duration_s=4", "channel.zeta_dB=0"], "ends_on_contact": True},
    "random": {"overrides": ["channel=acoustic_24khz", "scenario.duration_s=2"], "random_start": True},
    "pair": {"overrides": ["experiment=fig6_pair", "scenario.duration_s=2"], "random_start": True, "guard": "energy"},
}
WORLDS, STEPS = 4, 14


def actions_of(env: RelayVectorEnv, step: int) -> np.ndarray:
    """Other ones for each world: the first goes straight at the obstacle, the last away."""
    share = np.random.default_rng(step).uniform(-0.3, 0.3, env.action_space.shape).astype(np.float32)
    share[:, 0] = np.linspace(1.0, -1.0, env.num_envs) * np.cos(1.0 - 3.9)
    return share


def assert_same(ours: Any, theirs: Any) -> None:
    """Arrays, tuples and dictionaries, numbers to the rounding of another batch size."""
    if isinstance(theirs, dict):
        assert ours.keys() == theirs.keys()
        for key in theirs:
            assert_same(ours[key], theirs[key])
    elif isinstance(theirs, tuple) or (isinstance(theirs, np.ndarray) and theirs.dtype == object):
        for a, b in zip(ours, theirs, strict=True):
            assert_same(a, b)
    elif theirs is None:
        assert ours is None
    else:
        assert (ours.dtype, ours.shape) == (theirs.dtype, theirs.shape)
        np.testing.assert_allclose(ours, theirs, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("mode", list(AutoresetMode), ids=lambda mode: mode.value)
@pytest.mark.parametrize("options", CASES.values(), ids=list(CASES))
def test_it_returns_what_single_environments_in_a_loop_return(options: dict, mode: AutoresetMode):
    task = make_task(**options)
    ours = RelayVectorEnv(task, WORLDS, autoreset_mode=mode)
    theirs = SyncVectorEnv([lambda: RelayEnv(task)] * WORLDS, autoreset_mode=mode)
    assert_same(ours.reset(seed=11), theirs.reset(seed=11))
    over = np.zeros(WORLDS, dtype=np.bool_)
    ended = 0
    for k in range(STEPS):
        if mode == AutoresetMode.DISABLED and over.any():
            assert_same(ours.reset(options={"reset_mask": over}), theirs.reset(options={"reset_mask": over.copy()}))
        actions = actions_of(ours, k)
        result = ours.step(actions)
        assert_same(result, theirs.step(actions))
        over = result[2] | result[3]
        ended += int(over.sum())
    assert ended > WORLDS


def test_seeds_may_be_given_one_by_one_and_some_worlds_left_as_they_are():
    task = make_task(**CASES["random"])
    ours, theirs = RelayVectorEnv(task, 3), SyncVectorEnv([lambda: RelayEnv(task)] * 3)
    assert_same(ours.reset(seed=[5, 2**40, 0]), theirs.reset(seed=[5, 2**40, 0]))
    assert_same(ours.reset(), theirs.reset())
    before, *_ = ours.step(actions_of(ours, 0))
    theirs.step(actions_of(ours, 0))
    mask = np.array([False, True, False])
    after, infos = ours.reset(seed=[None, 9, None], options={"reset_mask": mask})
    assert_same((after, infos), theirs.reset(seed=[None, 9, None], options={"reset_mask": mask.copy()}))
    np.testing.assert_array_equal(after[[0, 2]], before[[0, 2]])
    assert infos["_J"].tolist() == mask.tolist()


def trace(env: RelayVectorEnv, seed: int | None, spoil: bool = False) -> list[np.ndarray]:
    """All that an environment returns over two episodes; spoil writes over it, and over the actions, afterwards."""
    kept: list[np.ndarray] = []
    returned: list[Any] = [env.reset(seed=seed)]
    for k in range(10):
        actions = actions_of(env, k)
        returned.append(env.step(actions))
        arrays = [x for x in [*returned[-1][:-1], *returned[-1][-1].values()] if isinstance(x, np.ndarray)]
        kept += [x.copy() for x in arrays if x.dtype != object]
        if spoil:
            for array in (actions, *arrays):
                array.fill(0)
    return kept


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_the_same_seed_gives_bitwise_the_same_and_another_something_else(mode: str):
    env = RelayVectorEnv(num_envs=3, autoreset_mode=mode, **CASES["random"])
    first, again, other = trace(env, 3), trace(env, 3), trace(env, 4)
    for one, two in zip(first, again, strict=True):
        np.testing.assert_array_equal(one, two)
    assert not np.array_equal(first[0], other[0])


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_nothing_that_is_returned_or_given_is_used_again(mode: str):
    task = make_task(**CASES["contacts"])
    plain, spoilt = (trace(RelayVectorEnv(task, 3, autoreset_mode=mode), 3, spoil) for spoil in (False, True))
    for one, two in zip(plain, spoilt, strict=True):
        np.testing.assert_array_equal(one, two)


def test_what_was_returned_does_not_change_later():
    env = RelayVectorEnv(num_envs=3, autoreset_mode="SameStep", **CASES["contacts"])
    held = [env.reset(seed=0)[0]]
    copies = [held[0].copy()]
    for k in range(10):
        observations, reward, terminated, truncated, infos = env.step(actions_of(env, k))
        arrays = [observations, reward, terminated, truncated, *(infos[key] for key in ("J", "_J", "clearance_m"))]
        held, copies = held + arrays, copies + [array.copy() for array in arrays]
    for array, copy in zip(held, copies, strict=True):
        np.testing.assert_array_equal(array, copy)


def test_every_episode_begins_elsewhere_and_in_other_water():
    env = RelayVectorEnv(num_envs=200, **CASES["random"])
    (first, _), (second, _) = env.reset(seed=0), env.reset()
    starts = np.concatenate([first, second])[:, :2].round(6)
    assert len(np.unique(starts, axis=0)) == 400
    # World 1 of seed 0 is not world 0 of seed 1.
    assert not np.array_equal(second[0], first[1])


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_arrays_have_the_types_of_the_spaces_whatever_the_world_computes_with(dtype: str):
    env = RelayVectorEnv(num_envs=2, overrides=[f"dtype={dtype}"])
    observations, _ = env.reset(seed=0)
    stepped, reward, terminated, truncated, _ = env.step(np.zeros((2, 4), dtype=np.float64))
    assert observations.dtype == stepped.dtype == np.float32
    assert (reward.dtype, terminated.dtype, truncated.dtype) == (np.float64, np.bool_, np.bool_)


def test_read_only_and_reversed_actions_are_taken():
    env = RelayVectorEnv(num_envs=2, overrides=["channel.zeta_dB=0"])
    env.reset(seed=0)
    constant = np.broadcast_to(np.float32(0.1), (2, 4))
    env.step(constant)
    env.step(np.ones((2, 4), dtype=np.float32)[::-1])


def test_an_action_beyond_one_is_what_thrusters_give():
    env = RelayVectorEnv(num_envs=2, overrides=["channel.zeta_dB=0"])
    env.reset(seed=[0, 0])
    share = np.array([[1.0, 0.0, 0.0, -1.0], [9.0, 0.0, 0.0, -3.0]], dtype=np.float32)
    observations, reward, *_ = env.step(share)
    np.testing.assert_array_equal(observations[0], observations[1])
    assert reward[0] == reward[1]


def test_wrappers_of_gymnasium_understand_the_infos():
    env = DictInfoToList(RecordEpisodeStatistics(RelayVectorEnv(num_envs=3, **CASES["random"])))
    env.reset(seed=0)
    for _ in range(4):
        _, _, _, truncated, infos = env.step(np.zeros((3, 4), dtype=np.float32))
    assert truncated.all()
    for info in infos:
        assert info["episode"]["r"] == pytest.approx(-info["J"])
        assert info["episode"]["l"] == 4


@pytest.mark.parametrize(
    ("actions", "got"),
    [
        ([[0.0] * 4] * 2, "got list"),
        (np.zeros((2, 3), dtype=np.float32), r"got float32 of shape \(2, 3\)"),
        (np.zeros((4,), dtype=np.float32), r"got float32 of shape \(4,\)"),
        (np.zeros((2, 4), dtype=np.int64), r"got int64 of shape \(2, 4\)"),
        (np.array([[0.0] * 4, [0.0, np.nan, 0.0, 0.0]]), r"got nan at \(1, 1\)"),
        (np.array([[0.0] * 4, [0.0, 0.0, -np.inf, 0.0]]), r"got -inf at \(1, 2\)"),
    ],
)
def test_what_is_no_action_is_refused_and_changes_nothing(actions: Any, got: str):
    env = RelayVectorEnv(num_envs=2, overrides=["channel.zeta_dB=0"])
    env.reset(seed=0)
    with pytest.raises(ValueError, match=rf"floating-point array of shape \(2, 4\) with entries from -1 to 1, {got}"):
        env.step(actions)
    assert env.step(np.zeros((2, 4)))[-1]["J"][0] > 0.0


@pytest.mark.parametrize("mode", list(AutoresetMode), ids=lambda mode: mode.value)
def test_a_step_before_reset_is_refused(mode: AutoresetMode):
    env = RelayVectorEnv(num_envs=2, overrides=["channel.zeta_dB=0"], autoreset_mode=mode)
    with pytest.raises(ResetNeeded, match=r"call reset\(\) before step\(\)"):
        env.step(np.zeros((2, 4)))


def test_without_autoreset_a_step_after_the_end_is_refused():
    env = RelayVectorEnv(num_envs=2, overrides=["scenario.duration_s=0.5"], autoreset_mode="Disabled")
    env.reset(seed=0)
    env.step(np.zeros((2, 4)))
    with pytest.raises(ResetNeeded, match="no episode is under way in 2 worlds"):
        env.step(np.zeros((2, 4)))


@pytest.mark.parametrize("mask", [[True, False], np.array([1, 0]), np.array([True]), np.zeros(2, dtype=np.bool_)])
def test_a_bad_mask_is_refused(mask: Any):
    env = RelayVectorEnv(num_envs=2, overrides=["channel.zeta_dB=0"])
    env.reset(seed=0)
    with pytest.raises(ValueError, match=r"reset_mask: must be a bool array of shape \(2,\) that is true somewhere"):
        env.reset(options={"reset_mask": mask})


def test_the_first_reset_is_of_all_worlds():
    env = RelayVectorEnv(num_envs=2, overrides=["channel.zeta_dB=0"])
    with pytest.raises(ValueError, match="reset_mask: the first reset must be of all worlds"):
        env.reset(options={"reset_mask": np.array([True, False])})


@pytest.mark.parametrize(
    ("seed", "message"),
    [([1], "seed: 2 are needed, one for each world, got 1"), ([1, -2], "a seed must be an integer"), ([1, 0.5], "0.5")],
)
def test_bad_seeds_are_refused(seed: list, message: str):
    env = RelayVectorEnv(num_envs=2, overrides=["channel.zeta_dB=0"])
    with pytest.raises(ValueError, match=message):
        env.reset(seed=seed)


def test_bad_modes_are_refused():
    with pytest.raises(ValueError, match="num_envs: must be at least 1, got 0"):
        RelayVectorEnv(num_envs=0)
    with pytest.raises(ValueError, match="'human'"):
        RelayVectorEnv(num_envs=1, render_mode="human")
    with pytest.raises(ValueError, match="Sometimes"):
        RelayVectorEnv(num_envs=1, autoreset_mode="Sometimes")


def test_make_vec_takes_options_and_renders():
    env = gymnasium.make_vec(
        "uwirl.envs:uwirl/Relay-v0", num_envs=2, render_mode="rgb_array", random_start=True, nearest_obstacles=0
    )
    env.reset(seed=0)
    frames = env.render()
    assert [frame.shape for frame in frames] == [(480, 480, 3)] * 2
    assert not np.array_equal(*frames)
