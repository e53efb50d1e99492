"""Synchronous forms have the methods, signatures and docstrings of the asynchronous ones."""

import inspect
from collections.abc import Callable
from typing import Any

import pytest

import brink
from brink.python.client import AsyncSubmitted, Submitted
from brink.python.function import search

CLASSES = [(brink.AsyncClient, brink.Client), (AsyncSubmitted, Submitted), (brink.AsyncResult, brink.Result)]
FUNCTIONS = [(brink.run_async, brink.run), (brink.search_async, search)]


def check_form(asynchronous: Callable[..., Any], form: Callable[..., Any]) -> None:
    assert inspect.getdoc(form) == inspect.getdoc(asynchronous)
    assert inspect.signature(form).parameters == inspect.signature(asynchronous).parameters
    assert "Async" not in str(inspect.signature(form).return_annotation)
    assert not inspect.iscoroutinefunction(form)


@pytest.mark.parametrize(("asynchronous", "form"), CLASSES)
def test_each_method_has_a_synchronous_form(asynchronous: type, form: type) -> None:
    methods = inspect.getmembers(asynchronous, inspect.iscoroutinefunction)
    names = [name for name, _ in methods if not name.startswith("_") and name not in ("fetch", "archive")]
    assert len(names) >= 3
    for name in names:
        check_form(getattr(asynchronous, name), getattr(form, name))
        assert getattr(form, name).__qualname__ == f"{form.__name__}.{name}"


@pytest.mark.parametrize(("asynchronous", "form"), FUNCTIONS)
def test_functions_have_synchronous_forms(asynchronous: Callable[..., Any], form: Callable[..., Any]) -> None:
    check_form(asynchronous, form)
    assert f"{form.__name__}_async" == asynchronous.__name__
