"""A device that is none: its tensors lie in the CPU's memory, but no operation takes them together with the CPU's.

Fake tensors have no values, so whatever asks for one (a guard's condition, an active set, a search) ends there. These
have values: whole commands run on them, to the same last digit as on the CPU, and every place where the CPU would wait
for a GPU is known. The device is a `lazy` one, because PyTorch without CUDA cannot index tensors that are said to be on
`cuda`.
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import torch
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode

DEVICE = torch.device("lazy", 0)
aten = torch.ops.aten
# Index tensors may lie on the CPU; these take them after the values.
INDEXING = {aten.index.Tensor, aten.index_put.default, aten.index_put_.default, aten._index_put_impl_.default}
COPIES = {aten._to_copy.default, aten.copy_.default}
# Their result, or its shape, depends on values, for which the CPU has to wait.
ASKING = {
    aten._local_scalar_dense.default,
    aten.equal.default,
    aten.nonzero.default,
    aten.masked_select.default,
    aten._unique2.default,
    aten.unique_dim.default,
    aten.repeat_interleave.Tensor,
    aten.bincount.default,
}


class Elsewhere(Tensor):
    """A tensor of the device; `here` is the same on the CPU."""

    here: Tensor
    __torch_function__ = torch._C._disabled_torch_function_impl

    @staticmethod
    def __new__(cls, here: Tensor) -> Elsewhere:
        shape, strides, offset = here.size(), here.stride(), here.storage_offset()
        wrapper: Elsewhere = Tensor._make_wrapper_subclass(
            cls, shape, strides=strides, storage_offset=offset, dtype=here.dtype, device=DEVICE
        )
        wrapper.here = here
        return wrapper

    @classmethod
    def __torch_dispatch__(cls, op: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        raise RuntimeError(f"{op} on tensors of {DEVICE}, which is no longer there")

    def __repr__(self, **kwargs: Any) -> str:
        return f"{self.here!r} of {DEVICE}"

    def numpy(self, *, force: bool = False) -> Any:
        if not force:
            raise TypeError(f"can't convert {DEVICE} device type tensor to numpy")
        return self.cpu().numpy()

    def __array__(self, *args: Any, **kwargs: Any) -> Any:
        return self.numpy()

    def tolist(self) -> list:
        return self.cpu().tolist()

    def __reduce_ex__(self, protocol: Any) -> Any:
        return self.here.__reduce_ex__(protocol)


class Device(TorchDispatchMode):
    """Makes the device exist.

    Attributes:
        waits: how often the CPU waited for it, by operation, file and line of uwirl.
    """

    def __init__(self) -> None:
        super().__init__()
        self.waits: Counter[str] = Counter()

    def __torch_dispatch__(self, op: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        tensors: list[Tensor] = []

        def here(x: Tensor) -> Tensor:
            tensors.append(x)
            return x.here if isinstance(x, Elsewhere) else x

        arguments = [_each(x, here) for x in args]
        named = {name: _each(x, here) for name, x in (kwargs or {}).items()}
        asked = named.get("device")
        if asked is not None:
            named["device"] = torch.device("cpu")
        away = any(isinstance(x, Elsewhere) for x in tensors)
        there = away if asked is None else asked.type == DEVICE.type
        if away and op not in COPIES:
            self._refuse_mixed(op, tensors[:1] if op in INDEXING else tensors)
        if (away or there) and self._waits(op, args, tensors, away != there):
            self.waits[f"{op} {_line()}"] += 1
        result = op(*arguments, **named)
        if op._schema.is_mutable:
            return _changed(op, args, kwargs or {})
        return _each(result, Elsewhere) if there else result

    @staticmethod
    def _refuse_mixed(op: Any, tensors: list[Tensor]) -> None:
        """As a GPU does, which takes numbers of the CPU and nothing else of it."""
        strangers = [x for x in tensors if x.ndim and not isinstance(x, Elsewhere)]
        if strangers:
            shapes = [list(x.shape) for x in strangers]
            raise RuntimeError(f"expected all tensors on one device: {op} has {shapes} of the CPU's at {_line()}")

    @staticmethod
    def _waits(op: Any, args: Any, tensors: list[Tensor], crosses: bool) -> bool:
        if op in COPIES:
            return crosses or len({type(x) for x in tensors}) > 1
        masks = op in INDEXING and any(x is not None and x.dtype == torch.bool for x in args[1])
        return op in ASKING or masks


@contextmanager
def elsewhere() -> Iterator[Device]:
    """The device, while the context lasts; PyTorch then makes tensors on the CPU first and sends them."""
    before = torch._C._only_lift_cpu_tensors()
    torch._C._set_only_lift_cpu_tensors(True)
    try:
        with Device() as device:
            yield device
    finally:
        torch._C._set_only_lift_cpu_tensors(before)


def _each(value: Any, change: Callable[[Tensor], Tensor]) -> Any:
    """A value with its tensors changed, in lists and tuples also."""
    if isinstance(value, Tensor):
        return change(value)
    return type(value)(_each(x, change) for x in value) if isinstance(value, (list, tuple)) else value


def _changed(op: Any, args: Any, kwargs: Any) -> Any:
    """What an operation has changed in place."""
    if torch.Tag.inplace_view in op.tags and isinstance(args[0], Elsewhere):
        # The wrapper's own shape: as fake tensors have it changed.
        with torch._C._DisableTorchDispatch(), torch._C._PreserveDispatchKeyGuard():
            torch._C._set_meta_in_tls_dispatch_include(True)
            op(*args, **kwargs)
    given = dict(zip([argument.name for argument in op._schema.arguments], args, strict=False)) | kwargs
    written = [x.name for x in op._schema.arguments if x.alias_info is not None and x.alias_info.is_write]
    changed = [given[name] for name in written if name in given]
    return changed[0] if len(changed) == 1 else tuple(changed)


def _line() -> str:
    """The line of uwirl that is at work."""
    frame = sys._getframe(1)
    while frame.f_back is not None and "/uwirl/" not in frame.f_code.co_filename:
        frame = frame.f_back
    return f"{frame.f_code.co_filename.rpartition('/uwirl/')[2]}:{frame.f_lineno}"
