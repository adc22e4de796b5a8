"""A graph of objects as bytes, and back: a copy that behaves as the original to the last bit, or an error.

It is a pickle, within one process. Beyond what pickle does by itself, arrays that share memory share it again afterwards and lie
in memory as before: an estimator may hold a view of its own state, and linear algebra takes another way through other strides.
"""

from __future__ import annotations

import gc
import io
import pickle
import sys
from operator import attrgetter
from types import FunctionType, MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gcs_coloc.core.errors import GcsColocError


class FreezeError(GcsColocError):
    """Something in a graph of objects cannot be copied, such as a function made within another or an open file."""


def freeze(graph: object) -> bytes:
    """The bytes of a graph of objects. Classes and functions are not copied but meant.

    Raises:
        FreezeError: something in it cannot be copied; the text says what.
    """
    buffer = io.BytesIO()
    try:
        _Freezer(buffer, protocol=4).dump(graph)
    except Exception as error:  # a plug-in's own methods take part, and can raise anything
        raise FreezeError(f"{type(error).__name__}: {error}") from error
    return buffer.getvalue()


def thaw(frozen: bytes) -> Any:
    """A fresh copy of a graph that was frozen in this process.

    Raises:
        FreezeError: something in it cannot be made again.
    """
    try:
        return pickle.loads(frozen)  # noqa: S301, nothing but what `freeze` made in this process comes here
    except Exception as error:
        raise FreezeError(f"{type(error).__name__}: {error}") from error


class _Freezer(pickle.Pickler):
    def reducer_override(self, obj: Any) -> Any:
        if type(obj) is np.ndarray and obj.base is not None and obj.size > 0:
            owner = _owner(obj)
            if owner is not obj:
                offset = obj.__array_interface__["data"][0] - owner.__array_interface__["data"][0]
                return _view, (owner, obj.shape, obj.dtype, offset, obj.strides)
        elif isinstance(obj, type | FunctionType) and obj.__module__.endswith(".py"):
            # A plug-in's file is a module under its path, which pickle's own import takes for a package.
            if "<" not in obj.__qualname__ and _named(obj.__module__, obj.__qualname__) is obj:
                return _named, (obj.__module__, obj.__qualname__)
        elif type(obj) is MappingProxyType:
            # Of what it shows there is no other way to get hold.
            return _read_only, tuple(gc.get_referents(obj))
        return NotImplemented


def _owner(array: NDArray[Any]) -> NDArray[Any]:
    """The array whose memory another one uses, or itself."""
    base = array.base
    if isinstance(base, memoryview):
        base = base.obj
    if isinstance(base, np.ndarray):
        return _owner(base)
    # An array that was thawed owns its memory in this shape.
    if base is not None and not isinstance(base, bytes):
        raise TypeError(f"an array over the memory of a {type(base).__name__}")
    if not array.flags.forc:
        raise TypeError("an array with gaps in its memory")
    return array


def _read_only(mapping: Any) -> Any:
    return MappingProxyType(mapping)


def _named(module: str, name: str) -> Any:
    return attrgetter(name)(sys.modules[module])


def _view(
    owner: NDArray[Any], shape: tuple[int, ...], dtype: np.dtype[Any], offset: int, strides: tuple[int, ...]
) -> NDArray[Any]:
    return np.ndarray(shape, dtype, owner.reshape(-1, order="A").data, offset, strides)
