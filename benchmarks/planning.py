"""How fast ways are planned and followed, on one thread.

    python benchmarks/planning.py

Times are those of the processor, so that other processes count little; the best of several calls stands beside the
median.

re-plan       the way of one vehicle between the obstacles of Fig. 5
batch of 32   of random layouts and of rings of 24 cylinders: time for each map
control step  of 1,000 worlds of random layouts or of one, all ways planned before: what the vehicles perceive, the
              agent's tau, the guard's correction, the integration, and a whole step of a rollout
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import replace

import torch

from uwirl import build
from uwirl.config.compose import compose
from uwirl.config.schema import Config
from uwirl.motion.guidance import GeodesicAgent
from uwirl.motion.route import BATCH
from uwirl.motion.targets import mean_channel_targets
from uwirl.snr.estimators import oracle
from uwirl.world.agent import Guarded
from uwirl.world.layouts import draw_layouts
from uwirl.world.random import RandomStreams
from uwirl.world.readings import take_readings
from uwirl.world.relay import Relay
from uwirl.world.truth import truth_of

WORLDS = 1000
SEED = 77
# Steps flown before control steps are timed, and those that are timed together.
WARM_STEPS, STEPS = 40, 20


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
    layouts = draw_layouts(streams, kinds, mean_channel_targets(env.scenario, truth_of(env).channel).frame.target)
    return env.on(replace(env.scenario, start=layouts.start, obstacles=layouts.obstacles), streams)


def led(config: Config, env: Relay) -> GeodesicAgent:
    """A damped spring led along the ways."""
    one = build.make_relay(config)
    truth = oracle(take_readings(one), one.budget, truth_of(one).channel)
    agent = build.make_planner(config, config.planner, env).fit(env, truth)
    assert isinstance(agent, GeodesicAgent)
    return agent


def replanning(config: Config, env: Relay) -> Callable[[], object]:
    """Plans the ways of all worlds from their starts."""
    router, (_, observation) = led(config, env).tracker.router, env.reset()
    known = observation.obstacles.each(lambda field: field.flatten(0, 1))
    return lambda: router.plan(torch.arange(env.worlds), observation.position[:, 0, :2], known, observation.time)


def control_step(config: Config, env: Relay, rounds: int) -> dict[str, list[float]]:
    """Times of a step's parts, ms."""
    agent, guard = led(config, env), build.make_guard(config, env)
    guarded = Guarded(agent, guard)
    flown = env.rollout(guarded, steps=WARM_STEPS)
    state, carry = flown.end, flown.carry
    observation = env.observe(state)
    tau, _ = agent.act(carry, observation)
    out = torch.empty_like(state.components)
    return {
        "observation": timed(lambda: env.observe(state), rounds),
        "agent": timed(lambda: agent.act(carry, observation), rounds),
        "guard": timed(lambda: guard(tau, observation), rounds),
        "integration": timed(lambda: env.vehicle.step(state.vehicles, tau, env.scenario.dt, out=out), rounds),
        "whole": timed(lambda: env.rollout(guarded, state, STEPS, carry), rounds // STEPS + 2, STEPS),
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
