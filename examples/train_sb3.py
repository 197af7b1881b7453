"""Stable-Baselines3's SAC learns to be a relay: `python examples/train_sb3.py 20000` (extras envs and compare)."""

import sys

import gymnasium
import numpy as np
from stable_baselines3 import SAC
from stable_baselines3.common.base_class import BaseAlgorithm

RELAY = "uwirl.envs:uwirl/Relay-v0"


def mission(model: BaseAlgorithm) -> float:
    """J of one mission from the scenario's start."""
    env = gymnasium.make(RELAY, guard="energy")
    (observation, info), over = env.reset(seed=0), False
    while not over:
        action, _ = model.predict(observation, deterministic=True)
        observation, _, terminated, truncated, info = env.step(np.asarray(action))
        over = terminated or truncated
    return float(info["J"])


def main(steps: int) -> tuple[float, float]:
    """J before and after so many steps of control."""
    env = gymnasium.make(RELAY, guard="energy", random_start=True)
    # Rewards are about -0.1 a step: entropy at SAC's usual weight of 1 would outweigh them.
    model = SAC("MlpPolicy", env, seed=0, ent_coef="auto_0.01", learning_rate=1e-3, gamma=0.98)
    before = mission(model)
    after = mission(model.learn(steps))
    print(f"J {before:.3f} before, {after:.3f} after {steps} steps of control")
    return before, after


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 5000)
