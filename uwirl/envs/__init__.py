"""The relay task for other learning libraries: Gymnasium and PettingZoo environments (extra `envs`).

gymnasium.make("uwirl.envs:uwirl/Relay-v0", overrides=["experiment=fig6_pair", "channel=acoustic_24khz"])
gymnasium.make_vec("uwirl.envs:uwirl/Relay-v0", num_envs=1000, random_start=True)
"""

import gymnasium

from uwirl.envs.making import make_task
from uwirl.envs.parallel import RelayParallelEnv
from uwirl.envs.single import RelayEnv
from uwirl.envs.task import RelayTask
from uwirl.envs.vector import RelayVectorEnv

__all__ = ["RelayEnv", "RelayParallelEnv", "RelayTask", "RelayVectorEnv", "make_task"]

gymnasium.register(
    "uwirl/Relay-v0",
    entry_point="uwirl.envs.single:RelayEnv",
    vector_entry_point="uwirl.envs.vector:RelayVectorEnv",
)
