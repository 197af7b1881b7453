"""What one core takes for a step of a rollout and for the guard, in nanoseconds a vehicle; `world.py` runs this file.

It measures one round for each line on its input, with whichever uwirl comes first on PYTHONPATH, so that two versions
can be asked in turn. That is why nothing is imported here but what both have.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from uwirl import build
from uwirl.config.compose import compose
from uwirl.world.random import RandomStreams

# Worlds, and the steps of a rollout that are timed together: as many as take about a tenth of a second.
STEPS = {1: 200, 1000: 100, 100_000: 2}
CALLS = 3


def flights(worlds: int) -> dict[str, Callable[[], object]]:
    """Calls to time, of worlds with the obstacles of Fig. 5: a rollout, the guard alone, and a rollout behind it."""
    config = compose(["experiment=fig5_single"])
    env = build.make_relay(config, RandomStreams.worlds(0, worlds))
    tau = env.vehicle.tau_max.new_tensor([20.0, 5.0, 0.0, 0.5]).expand(worlds, 1, 4)
    try:
        return by_agents(config, env, tau, STEPS[worlds])
    except ImportError:
        return by_policies(config, env, tau, STEPS[worlds])


def by_agents(config: Any, env: Any, tau: Tensor, steps: int) -> dict[str, Callable[[], object]]:
    """Of this version."""
    from uwirl.world.agent import Feedback, Guarded

    agent, guard, (state, observation) = Feedback(lambda observation: tau), build.make_guard(config, env), env.reset()
    return {
        "rollout": lambda: env.rollout(agent, state, steps),
        "guard": lambda: [guard(tau, observation) for _ in range(steps)],
        "guarded rollout": lambda: env.rollout(Guarded(agent, guard), state, steps),
    }


def by_policies(config: Any, env: Any, tau: Tensor, steps: int) -> dict[str, Callable[[], object]]:
    """Of 0.1, where policies were functions of state and step."""
    make_guard: Any = build.make_guard
    state = env.reset()

    def held(state: Any, step: int) -> Tensor:
        return tau

    guarded = make_guard(config)(env, held)
    return {
        "rollout": lambda: env.rollout(held, state, steps),
        "guard": lambda: [guarded(state, 0) for _ in range(steps)],
        "guarded rollout": lambda: env.rollout(guarded, state, steps),
    }


def best(call: Callable[[], object], per: int) -> float:
    """Nanoseconds of the processor that each of `per` parts of a call takes: the least of several calls."""
    times = []
    for _ in range(CALLS):
        begin = time.process_time_ns()
        call()
        times.append((time.process_time_ns() - begin) / per)
    return min(times)


@torch.no_grad()
def main() -> None:
    """Answer each line of the input with a round's times as JSON."""
    torch.set_num_threads(1)
    calls = {(name, worlds): call for worlds in STEPS for name, call in flights(worlds).items()}
    for _ in sys.stdin:
        times = {f"{name}, B = {w:,}": best(call, w * STEPS[w]) for (name, w), call in calls.items()}
        print(json.dumps(times), flush=True)


if __name__ == "__main__":
    main()
