"""Integral reinforcement learning for underwater vehicles that relay data over a fading acoustic channel."""

__version__ = "0.1.0"
