"""Settings of a language model: bounds, and protection against leaked secrets."""

from typing import Any

import pytest
from pydantic import ValidationError

from brink.server.documents import invalid_input
from brink.server.llm.settings import LlmSettings

SECRET = "sk-proj-0123456789abcdef"


def settings(**changes: Any) -> LlmSettings:
    return LlmSettings.model_validate({"endpoint": "http://127.0.0.1:8000/v1", "model": "m", **changes})


def refused(**changes: Any) -> tuple[str, str]:
    """Return the pointer of the error, and everything that the error shows anywhere."""
    with pytest.raises(ValidationError) as caught:
        settings(**changes)
    [error] = invalid_input(caught.value, LlmSettings).errors
    everything = f"{caught.value} {caught.value!r} {caught.value.errors()} {error}"
    return error.pointer, everything


def test_the_delay_limit_is_twice_the_timeout_unless_it_is_set() -> None:
    assert settings(timeout_s=900).delay_limit_s == 1800
    assert settings(timeout_s=5).delay_limit_s == 60
    assert settings(timeout_s=900, max_delay_s=30).delay_limit_s == 30


def test_every_field_has_a_description() -> None:
    for name, field in LlmSettings.model_fields.items():
        assert field.description, name


@pytest.mark.parametrize(
    ("given", "kept"),
    [
        ("https://api.example.org/v1/", "https://api.example.org/v1"),
        ("http://127.0.0.1:8000/v1/chat/completions", "http://127.0.0.1:8000/v1"),
        ("http://[::1]:11434/v1", "http://[::1]:11434/v1"),
    ],
)
def test_endpoints_are_normalised(given: str, kept: str) -> None:
    assert settings(endpoint=given).endpoint == kept


@pytest.mark.parametrize(
    "endpoint",
    [
        "",
        "127.0.0.1:8000/v1",
        "ftp://host/v1",
        "http://",
        "http://a b/v1",
        "http://host:99999/v1",
        "http://h\n/v1",
        "http://host/v1/../admin",
        "http://host/v1/%2e%2e/admin",
        "http://host/v1/..%2fadmin",
        "http://host/./v1",
        "http://host\\v1",
        7,
    ],
)
def test_invalid_endpoints_are_rejected(endpoint: object) -> None:
    pointer, _ = refused(endpoint=endpoint)
    assert pointer == "/endpoint"


@pytest.mark.parametrize(
    "endpoint",
    [
        f"https://user:{SECRET}@host/v1",
        f"user:{SECRET}@host/v1",
        f"https://host/v1?key={SECRET}",
        f"https://host/v1#{SECRET}",
    ],
)
def test_credentials_in_an_endpoint_are_rejected_and_not_repeated(endpoint: str) -> None:
    pointer, everything = refused(endpoint=endpoint)
    assert pointer == "/endpoint"
    assert "api_key_env" in everything
    assert SECRET not in everything


@pytest.mark.parametrize("name", [SECRET, "lower_case", "", "A B", "1A"])
def test_a_key_instead_of_a_variable_name_is_rejected_and_not_repeated(name: str) -> None:
    pointer, everything = refused(api_key_env=name)
    assert pointer == "/api_key_env"
    assert "OPENAI_API_KEY" in everything
    assert SECRET not in everything


@pytest.mark.parametrize("field", ["api_key", "apikey", "token", "Authorization"])
def test_a_key_field_is_rejected_and_not_repeated(field: str) -> None:
    pointer, everything = refused(**{field: SECRET})
    assert pointer == f"/{field}"
    assert "api_key_env" in everything
    assert SECRET not in everything


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("temperature", 2.5),
        ("temperature", float("nan")),
        ("top_p", 0.0),
        ("seed", -1),
        ("seed", 1.5),
        ("max_tokens", 10),
        ("token_field", "tokens"),
        ("timeout_s", 0.0),
        ("timeout_s", float("inf")),
        ("retries", -1),
        ("max_wait_s", -1.0),
        ("max_calls", 0),
        ("max_delay_s", 0),
        ("max_total_tokens", 0),
        ("input_price", -1.0),
        ("model", ""),
        ("modell", "m"),
    ],
)
def test_each_invalid_value_is_rejected_with_its_pointer(field: str, value: object) -> None:
    pointer, _ = refused(**{field: value})
    assert pointer == f"/{field}"


@pytest.mark.parametrize(
    ("prices", "missing"),
    [
        ({}, "input_price and output_price"),
        ({"input_price": 1.0}, "output_price"),
        ({"output_price": 1.0}, "input_price"),
    ],
)
def test_max_cost_requires_both_prices(prices: dict[str, float], missing: str) -> None:
    pointer, everything = refused(max_cost=5.0, **prices)
    assert pointer == "/max_cost"
    assert f"expected {missing} too" in everything
