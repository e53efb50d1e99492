"""Which values of a parametrised test run every time, and which are left to `make test-all`."""

from collections.abc import Collection, Iterable
from typing import Any

import pytest


def mostly_long(values: Iterable[Any], always: Collection[Any], reason: str) -> list[Any]:
    """Return parameters of which all but a few are marked ``long``.

    Args:
        values: The values of the parameter; tuples for several parameters.
        always: Those that `make test` runs.
        reason: Why the others are left to `make test-all`.
    """
    values, mark = list(values), pytest.mark.long(reason)
    assert all(value in values for value in always), f"expected {always} among {values}"
    return [
        value
        if value in always
        else pytest.param(*(value if isinstance(value, tuple) else (value,)), marks=mark)
        for value in values
    ]
