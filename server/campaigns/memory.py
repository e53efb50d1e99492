"""Estimates the memory of a search's state without running any code of its objects."""

import gc
import sys
from collections.abc import Iterable
from types import BuiltinFunctionType, FunctionType, MethodType, ModuleType
from typing import Any, Final

import numpy as np

_NOT_ITS_OWN: Final = (type, ModuleType, FunctionType, BuiltinFunctionType, MethodType)
_SIZED: Final = (str, bytes, int, float, tuple, list, dict, set, frozenset)
_OBJECT_BYTES: Final = 64


def memory_of(thing: object, without: Iterable[object] = ()) -> int:
    """Return the approximate size of an object in bytes, including everything that it refers to.

    Args:
        thing: The object.
        without: Objects that belong to others.
    """
    seen = {id(one) for one in without}
    waiting: list[Any] = [thing]
    total = 0
    while waiting:
        one = waiting.pop()
        kind = type(one)  # isinstance would ask the object
        if id(one) in seen or issubclass(kind, _NOT_ITS_OWN):
            continue
        seen.add(id(one))
        if issubclass(kind, np.ndarray):
            if one.base is None:
                total += one.nbytes
            else:
                waiting.append(one.base)
            continue
        total += sys.getsizeof(one) if kind in _SIZED else _OBJECT_BYTES
        waiting += gc.get_referents(one)
    return total
