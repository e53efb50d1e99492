"""Settings of a worker are validated; log lines carry their fields as text and as JSON."""

import json
import logging
import subprocess
import sys
from typing import Any

import pytest

from brink.worker.errors import SettingsError
from brink.worker.log import (
    FORMAT_VARIABLE,
    JsonFormatter,
    LineFormatter,
    LogFormat,
    environment_format,
    log_fields,
)
from brink.worker.settings import WorkerSettings


def record(**fields: Any) -> logging.LogRecord:
    known = {
        "name": "brink.server.queue",
        "levelname": "INFO",
        "msg": "lease ran out",
        "created": 1_700_000_000.25,
    }
    return logging.makeLogRecord({**known, **fields})


def parsed(made: logging.LogRecord, **always: Any) -> dict[str, Any]:
    line = JsonFormatter(**always).format(made)
    assert "\n" not in line
    document: dict[str, Any] = json.loads(line)
    return document


def test_a_json_line_has_time_level_logger_message_and_all_fields() -> None:
    assert parsed(record(campaign="c0ffee", job=7, attempt=2), worker="w-1") == {
        "time": "2023-11-14T22:13:20.250Z",
        "level": "info",
        "logger": "brink.server.queue",
        "message": "lease ran out",
        "worker": "w-1",
        "campaign": "c0ffee",
        "job": 7,
        "attempt": 2,
    }


def test_a_stack_is_a_field_of_the_json_line() -> None:
    try:
        json.loads("{")
    except ValueError as error:
        document = parsed(record(msg="broken", exc_info=(type(error), error, error.__traceback__)))
    assert document["message"] == "broken"
    assert document["stack"].rstrip().splitlines()[-1].startswith("json.decoder.JSONDecodeError")


@pytest.mark.parametrize("value", [float("nan"), float("-inf"), b"bytes", object(), "two\nlines"])
def test_a_field_of_any_value_is_written_as_valid_json(value: object) -> None:
    def refuse(constant: str) -> None:
        raise AssertionError(f"{constant} is not JSON")

    line = JsonFormatter().format(record(reason=value))
    assert "\n" not in line
    assert "reason" in json.loads(line, parse_constant=refuse)


def test_a_field_cannot_replace_a_reserved_one() -> None:
    document = parsed(record(level="high", time="noon"))
    assert (document["level"], document["level_"], document["time_"]) == ("info", "high", "noon")


def test_log_fields_apply_only_inside_their_block() -> None:
    with log_fields(request="r-1"), log_fields(campaign="c0ffee"):
        inside = LineFormatter().format(record())
    assert inside.endswith("brink.server.queue: lease ran out request=r-1 campaign=c0ffee")
    assert "request" not in parsed(record())


def test_the_log_format_is_read_from_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(FORMAT_VARIABLE, raising=False)
    assert environment_format() is LogFormat.TEXT
    monkeypatch.setenv(FORMAT_VARIABLE, "JSON")
    assert environment_format() is LogFormat.JSON
    monkeypatch.setenv(FORMAT_VARIABLE, "xml")
    with pytest.raises(SettingsError, match="BRINK_LOG_FORMAT: expected one of text, json, got 'xml'"):
        environment_format()


def test_libraries_log_no_debug_records_even_at_debug_level() -> None:
    program = """
import logging
from brink.worker.log import LogFormat, LogLevel, configure_logging
configure_logging(LogLevel.DEBUG, LogFormat.TEXT)
for name in ("brink.worker.loop", "httpcore.http11", "h11"):
    logging.getLogger(name).debug("a detail of %s", name)
    logging.getLogger(name).info("news of %s", name)
logging.getLogger("httpx").info("a request")
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    logged = [line.partition(": ")[2] for line in done.stderr.splitlines()]
    assert logged == [
        "a detail of brink.worker.loop",
        "news of brink.worker.loop",
        "news of httpcore.http11",
        "news of h11",
    ]


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("server", "127.0.0.1:8700"),
        ("server", "ftp://host"),
        ("server", ""),
        ("worker_id", ""),
        ("worker_id", "x" * 65),
        ("max_jobs", 0),
        ("max_jobs", 129),
        ("wait_s", 61.0),
        ("wait_s", -1.0),
        ("memory_mib", -1),
        ("grace_s", float("inf")),
        ("prefetch_s", float("nan")),
        ("exit_when_idle_s", -0.1),
    ],
)
def test_an_error_names_the_setting_that_is_out_of_range(field: str, value: Any) -> None:
    with pytest.raises(SettingsError) as caught:
        WorkerSettings(**{"server": "http://127.0.0.1:8700", field: value})
    assert caught.value.field == field
    assert "expected" in str(caught.value)


def test_the_token_is_not_part_of_the_repr() -> None:
    assert "hush" not in repr(WorkerSettings(server="http://c", token="hush"))


def test_a_text_line_is_one_line_with_its_fields() -> None:
    record = logging.makeLogRecord(
        {
            "name": "brink.worker.loop",
            "levelname": "WARNING",
            "msg": "two\nlines",
            "job": 7,
            "reason": "no luck",
        }
    )
    line = LineFormatter(worker="w-1").format(record)
    assert line.endswith('WARNING brink.worker.loop: two lines worker=w-1 job=7 reason="no luck"')
