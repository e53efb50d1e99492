"""Log lines: what stands in them, as text and as JSON, and what libraries may say."""

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
    about,
    environment_format,
)


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


def test_a_json_line_has_time_level_logger_and_message_and_a_field_for_each_thing_it_is_about() -> None:
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


def test_a_stack_stays_on_the_line_of_json() -> None:
    try:
        json.loads("{")
    except ValueError as error:
        document = parsed(record(msg="broken", exc_info=(type(error), error, error.__traceback__)))
    assert document["message"] == "broken"
    assert document["stack"].rstrip().splitlines()[-1].startswith("json.decoder.JSONDecodeError")


@pytest.mark.parametrize("value", [float("nan"), float("-inf"), b"bytes", object(), "two\nlines"])
def test_whatever_a_field_holds_the_line_is_json(value: object) -> None:
    def refuse(constant: str) -> None:
        raise AssertionError(f"{constant} is no JSON")

    line = JsonFormatter().format(record(reason=value))
    assert "\n" not in line
    assert "reason" in json.loads(line, parse_constant=refuse)


def test_no_field_takes_the_place_of_the_lines_own() -> None:
    document = parsed(record(level="high", time="noon"))
    assert (document["level"], document["level_"], document["time_"]) == ("info", "high", "noon")


def test_what_a_block_is_about_stands_on_its_lines_alone() -> None:
    with about(request="r-1"), about(campaign="c0ffee"):
        inside = LineFormatter().format(record())
    assert inside.endswith("brink.server.queue: lease ran out request=r-1 campaign=c0ffee")
    assert "request" not in parsed(record())


def test_the_format_is_taken_from_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(FORMAT_VARIABLE, raising=False)
    assert environment_format() is LogFormat.TEXT
    monkeypatch.setenv(FORMAT_VARIABLE, "JSON")
    assert environment_format() is LogFormat.JSON
    monkeypatch.setenv(FORMAT_VARIABLE, "xml")
    with pytest.raises(SettingsError, match="BRINK_LOG_FORMAT: expected one of text, json, got 'xml'"):
        environment_format()


def test_libraries_tell_no_details_however_much_is_asked_for() -> None:
    program = """
import logging
from worker.log import LogFormat, LogLevel, configure_logging
configure_logging(LogLevel.DEBUG, LogFormat.TEXT)
for name in ("brink.worker.loop", "httpcore.http11", "h11"):
    logging.getLogger(name).debug("a detail of %s", name)
    logging.getLogger(name).info("news of %s", name)
logging.getLogger("httpx").info("a request")
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    said = [line.partition(": ")[2] for line in done.stderr.splitlines()]
    assert said == [
        "a detail of brink.worker.loop", "news of brink.worker.loop", "news of httpcore.http11", "news of h11",
    ]  # fmt: skip
