"""Stable-Baselines3's SAC learns to be a relay: `python examples/train_sb3.py 20000` (extras envs and compare)."""

import sys

import gymnasium
from stable_baselines3 import SAC
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.monitor import Monitor


def relay(**options: bool) -> gymnasium.Env:
    return Monitor(gymnasium.make("uwirl.envs:uwirl/Relay-v0", guard="energy", **options))


def main(steps: int) -> tuple[float, float]:
    """J of the mission from the scenario's start, before and after so many steps of control."""
    # Rewards are about -0.1 a step: entropy at SAC's usual weight of 1 would outweigh them.
    settings = {"ent_coef": "auto_0.01", "learning_rate": 1e-3, "gamma": 0.98}
    model = SAC("MlpPolicy", relay(random_start=True), seed=0, **settings)
    before, _ = evaluate_policy(model, relay(), n_eval_episodes=1)
    after, _ = evaluate_policy(model.learn(steps), relay(), n_eval_episodes=1)
    print(f"J {-before:.3f} before, {-after:.3f} after {steps} steps of control")
    return -before, -after


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 5000)
