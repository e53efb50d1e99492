"""Which language models may be contacted, and which keys may be sent there."""

from typing import Any

import pytest

from brink.server.errors import InvalidInput
from brink.server.llm.access import LlmAccess
from brink.server.llm.protocol import NotSent
from brink.server.llm.settings import LlmSettings
from brink.server.settings import Settings

SECRET = "sk-proj-0123456789abcdef"
HOSTED = "https://api.example.com/v1"


def settings(endpoint: str = HOSTED, **changes: Any) -> LlmSettings:
    return LlmSettings.model_validate({"endpoint": endpoint, "model": "m", **changes})


@pytest.mark.parametrize(
    ("allowed", "endpoint", "key", "field"),
    [
        ("", "http://127.0.0.1:8000/v1", None, None),
        ("", "http://127.0.0.1:8000/v1", "MY_KEY", "api_key_env"),
        ("", HOSTED, None, "endpoint"),
        ("*", HOSTED, None, None),
        ("*", HOSTED, "MY_KEY", "api_key_env"),
        (HOSTED, HOSTED, None, None),
        (HOSTED, HOSTED, "MY_KEY", "api_key_env"),
        (f"{HOSTED} MY_KEY", HOSTED, "MY_KEY", None),
        (f"{HOSTED}/ OTHER  MY_KEY", HOSTED, "MY_KEY", None),
        (f"{HOSTED} MY_KEY", HOSTED, "PATH", "api_key_env"),
        (f"{HOSTED} MY_KEY, http://10.0.0.5:8000", "http://10.0.0.5:8000/v1", "MY_KEY", "api_key_env"),
        (f"{HOSTED} MY_KEY, *", "https://evil.example/v1", "MY_KEY", "api_key_env"),
        ("https://api.example.com MY_KEY", "https://api.example.com.evil/v1", "MY_KEY", "endpoint"),
        ("https://api.example.com MY_KEY", "http://api.example.com/v1", "MY_KEY", "endpoint"),
        ("http://127.0.0.1:8000/v1 MY_KEY", "http://127.0.0.1:9000/v1", "MY_KEY", "api_key_env"),
    ],
)
def test_a_key_is_sent_only_where_the_operator_pairs_it_with_the_address(
    allowed: str, endpoint: str, key: str | None, field: str | None
) -> None:
    access, wanted = LlmAccess.parse(allowed, {"MY_KEY": SECRET}), settings(endpoint, api_key_env=key)
    if field is None:
        access.check(wanted)
        sent = access.key(wanted)
        assert (sent.get_secret_value() if sent is not None else None) == (SECRET if key else None)
        return
    with pytest.raises(InvalidInput, match=f"llm.{field}: .*BRINK_LLM_ENDPOINTS='{endpoint}") as caught:
        access.check(wanted)
    assert [error.pointer for error in caught.value.errors] == [f"/llm/{field}"]
    with pytest.raises(NotSent) as refused:
        access.key(wanted)
    assert SECRET not in f"{caught.value} {refused.value} {access!r}"


def test_a_file_that_its_user_runs_may_name_an_endpoint_but_no_key() -> None:
    own = settings(api_key_env="AWS_SECRET_ACCESS_KEY")
    allowed = Settings(llm_endpoints="").allowing([own.endpoint]).llm_endpoints
    access = LlmAccess.parse(allowed, {"AWS_SECRET_ACCESS_KEY": SECRET})
    access.check(settings())
    with pytest.raises(NotSent, match="may not send the key in AWS_SECRET_ACCESS_KEY"):
        access.key(own)


@pytest.mark.parametrize(
    "entry",
    [
        "api.example.com",
        "https://",
        f"{HOSTED} sk-{SECRET}",
        "* MY_KEY",
        "https://user:pw@host/v1",
        "ftp://x",
    ],
)
def test_a_malformed_entry_is_refused_without_being_repeated(entry: str) -> None:
    with pytest.raises(InvalidInput, match=r"^BRINK_LLM_ENDPOINTS: expected") as caught:
        LlmAccess.parse(f"{HOSTED} MY_KEY,, {entry}")
    assert SECRET not in str(caught.value)
    assert "pw" not in str(caught.value)


def test_the_key_comes_from_the_environment() -> None:
    key = LlmAccess.parse(f"{HOSTED} MY_KEY", {"MY_KEY": f" {SECRET}\n"}).key(settings(api_key_env="MY_KEY"))
    assert key is not None
    assert key.get_secret_value() == SECRET
    assert SECRET not in repr(key)


@pytest.mark.parametrize(
    "environ", [{}, {"MY_KEY": "  "}, {"MY_KEY": "schlüssel-geheim"}, {"MY_KEY": "geheim 1"}]
)
def test_a_missing_or_invalid_key_is_reported_by_its_variable(environ: dict[str, str]) -> None:
    with pytest.raises(NotSent, match="MY_KEY") as caught:
        LlmAccess.parse(f"{HOSTED} MY_KEY", environ).key(settings(api_key_env="MY_KEY"))
    assert "geheim" not in str(caught.value)
