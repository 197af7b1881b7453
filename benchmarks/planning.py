"""How fast ways are planned and followed, on one thread.

    python benchmarks/planning.py

Times are those of the processor, so that other processes count little; the best of several calls stands beside the
median.

re-plan       the way of one vehicle between the obstacles of Fig. 5
batch of 32   of random layouts and of rings of 24 cylinders: time for each map
control step  of 1,000 worlds of random layouts or of one, all ways planned before: the policy's tau, the guard's
              correction, the vehicle's integration, and a whole step of a rollout
"""

from __future__ import annotations

import itertools
import statistics
import time
from collections.abc import Callable
from dataclasses import replace

import torch
from torch import Tensor

from uwirl import build
from uwirl.config.compose import compose
from uwirl.config.schema import Config
from uwirl.motion.guidance import GeodesicPolicy
from uwirl.motion.route import BATCH
from uwirl.motion.targets import mean_channel_targets
from uwirl.snr.estimators import oracle
from uwirl.world.layouts import draw_layouts
from uwirl.world.random import RandomStreams
from uwirl.world.readings import take_readings
from uwirl.world.relay import Relay
from uwirl.world.vehicle import VehicleState

WORLDS = 1000
SEED = 77
# Steps flown before control steps are timed, those that are timed together, and the numbers left between such.
WARM_STEPS, STEPS, LATER = 40, 20, 10_000


def timed(call: Callable[[], object], rounds: int, per: int = 1) -> list[float]:
    """Milliseconds that each of `per` parts of a call takes, of so many calls after one that is not timed."""
    times = []
    for _ in range(rounds + 1):
        begin = time.process_time()
        call()
        times.append(1e3 * (time.process_time() - begin) / per)
    return times[1:]


def row(name: str, times: list[float]) -> None:
    """Print a line of the table."""
    print(f"{name:<40} {statistics.median(times):>10.3f} {min(times):>10.3f}", flush=True)


def drawn(env: Relay, kinds: list[str], count: int) -> Relay:
    """Random layouts between the same nodes."""
    streams = RandomStreams.worlds(SEED, count)
    layouts = draw_layouts(streams, kinds, mean_channel_targets(env.scenario, env.channel).frame.target)
    return env.on(replace(env.scenario, start=layouts.start, obstacles=layouts.obstacles), streams)


def led(config: Config, env: Relay) -> GeodesicPolicy:
    """A damped spring led along the ways; they are planned with its first step."""
    one = build.make_relay(config)
    policy = build.make_planner(config, config.planner, env).fit(env, oracle(take_readings(one), one.channel))
    assert isinstance(policy, GeodesicPolicy)
    return policy


def replanning(config: Config, env: Relay) -> Callable[[], object]:
    """Plans the ways of all worlds from their starts."""
    router, start = led(config, env).pilot.router, env.reset().position[:, 0, :2]
    obstacles = env.scenario.obstacles
    known = obstacles if obstacles.radius.ndim == 2 else obstacles.each(lambda field: field[None])
    return lambda: router.plan(torch.arange(env.worlds), start, known, 0.0)


def control_step(config: Config, env: Relay, rounds: int) -> dict[str, list[float]]:
    """Times of a step's parts, ms."""
    policy, guard = led(config, env), build.make_guard(config)
    state = env.rollout(guard(env, policy), env.reset(), WARM_STEPS).last
    # A step that is not later than the one before would begin a new flight, and plan.
    step, legs = itertools.count(WARM_STEPS), itertools.count(2 * LATER, LATER)
    tau = policy(state, next(step))
    out = torch.empty_like(state.components)

    def held(state: VehicleState, step: int) -> Tensor:
        return tau

    guarded = guard(env, held)
    return {
        "policy": timed(lambda: policy(state, next(step)), rounds),
        "guard": timed(lambda: guarded(state, 0), rounds),
        "integration": timed(lambda: env.vehicle.step(state, tau, env.scenario.dt, out=out), rounds),
        "whole": timed(lambda: env.rollout(guard(env, policy), state, STEPS, next(legs)), rounds // STEPS + 2, STEPS),
    }


@torch.no_grad()
def main() -> None:
    """Print the table."""
    torch.set_num_threads(1)
    config = compose(["experiment=fig5_single", "planner=pd"])
    env = build.make_relay(config)
    print(f"{'ms':<40} {'median':>10} {'best':>10}")
    row("re-plan", timed(replanning(config, env), 9))
    for kind in ("random", "ring"):
        row(f"batch of {BATCH}, {kind}: a map", timed(replanning(config, drawn(env, [kind], BATCH)), 3, BATCH))
    for count, rounds in ((1, 200), (WORLDS, 60)):
        for part, times in control_step(config, drawn(env, ["random"], count), rounds).items():
            row(f"control step of {count:,} worlds: {part}", times)


if __name__ == "__main__":
    main()
