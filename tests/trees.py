"""Carries, observations and states compared leaf by leaf."""

from __future__ import annotations

from dataclasses import is_dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor
from torch.utils import _pytree as pytree


def copied(tree: Any) -> Any:
    """With tensors of its own."""
    return pytree.tree_map(lambda leaf: leaf.clone() if isinstance(leaf, Tensor) else leaf, tree)


def assert_same(found: Any, expected: Any) -> None:
    """Of one structure, and bitwise equal; nan equals nan."""
    leaves, structure = pytree.tree_flatten(found)
    others, other_structure = pytree.tree_flatten(expected)
    assert structure == other_structure
    for leaf, other in zip(leaves, others, strict=True):
        if isinstance(other, Tensor):
            torch.testing.assert_close(leaf, other, rtol=0.0, atol=0.0, equal_nan=True)
        elif is_dataclass(other):
            assert_same(vars(leaf), vars(other))
        else:
            assert leaf == other


def through_a_file(tree: Any, path: Path) -> Any:
    """Saved as plain data, which no code has to be trusted for, and loaded again."""
    leaves, structure = pytree.tree_flatten(tree)
    torch.save(leaves, path)
    return pytree.tree_unflatten(torch.load(path, weights_only=True), structure)
