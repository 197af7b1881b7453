"""What the vector environment costs beside its world: one step of control of 10,000 worlds, on one thread.

A step of control is ten steps of the world. Beside it stand the same ten steps with the same held tau by themselves,
`Relay.step` in a loop and `Relay.rollout`: what the environment adds are rewards, contacts, readings of the links,
observations and numpy arrays. Measured in turn, in processor time, so that other programs disturb little; a ratio
is the median of those within rounds. Shadowing is measured with fewer worlds: a reading of it is a sum of 512 cosines.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable

import numpy as np
import torch

from uwirl.envs import RelayVectorEnv, make_task
from uwirl.world.agent import Feedback
from uwirl.world.random import RandomStreams

WORLDS, SHADOWED_WORLDS = 10_000, 500
ROUNDS = 15
CASES = {
    "two obstacles, float32": (WORLDS, ["dtype=float32", "channel.zeta_dB=0"]),
    "two obstacles, float64": (WORLDS, ["dtype=float64", "channel.zeta_dB=0"]),
    "free water, float32": (WORLDS, ["dtype=float32", "channel.zeta_dB=0", "experiment=fig5_free"]),
    "free water, float64": (WORLDS, ["dtype=float64", "channel.zeta_dB=0", "experiment=fig5_free"]),
    "two obstacles, shadowed": (SHADOWED_WORLDS, []),
}


def seconds(work: Callable[[], object]) -> float:
    """Processor time of one call."""
    begin = time.process_time()
    work()
    return time.process_time() - begin


def workloads(worlds: int, overrides: list[str]) -> list[Callable[[], object]]:
    """A step of control by the environment, by steps of the world, and by a rollout."""
    task = make_task(overrides, random_start=True)
    env = RelayVectorEnv(task, worlds)
    env.reset(seed=0)
    action = np.full((worlds, 4), 0.1, dtype=np.float32)
    judge = task.worlds(RandomStreams.worlds(0, worlds))
    start = task.begin(judge).world
    tau = 0.1 * judge.env.vehicle.tau_max.expand(worlds, 1, 4).contiguous()
    agent = Feedback(lambda observation: tau)

    def steps() -> None:
        state = start
        for _ in range(task.hold):
            state, _ = judge.env.step(state, tau)

    return [lambda: env.step(action), steps, lambda: judge.env.rollout(agent, start, task.hold)]


def main() -> None:
    torch.set_num_threads(1)
    print("million world steps per second of one core\n")
    print(f"{'':26} {'worlds':>7} {'env':>7} {'step':>7} {'rollout':>8} {'env/step':>9} {'env/rollout':>12}")
    with torch.inference_mode():
        for name, (worlds, overrides) in CASES.items():
            works = workloads(worlds, overrides)
            for work in works:
                work()
            taken = [[seconds(work) for work in works] for _ in range(ROUNDS)]
            rates = [10 * worlds / statistics.median(times) / 1e6 for times in zip(*taken, strict=True)]
            by_step, by_rollout = (statistics.median(times[k] / times[0] for times in taken) for k in (1, 2))
            env, step, rollout = rates
            print(
                f"{name:26} {worlds:>7,} {env:>7.2f} {step:>7.2f} {rollout:>8.2f} {by_step:>9.2f} {by_rollout:>12.2f}"
            )


if __name__ == "__main__":
    main()
