"""Campaigns that reach out: to other hosts, to files, to modules, to the environment."""

from collections.abc import Iterable
from typing import Any

from support.api import ball
from support.hostile import Answer, Attack, Target, row


def _asks(endpoint: str, **more: Any) -> dict[str, Any]:
    return {
        **ball(seed=9),
        "problem": {"id": "npc-actions@1"},
        "algorithm": {"id": "mumoea@1", "params": {"seeder": "llm"}},
        "budget": {"simulations": 2000},
        "llm": {"endpoint": endpoint, "model": "x", **more},
    }


@row("a language model on another host", 422, says="/llm/endpoint")
def _elsewhere(target: Target) -> Iterable[Answer]:
    for endpoint in (
        "http://169.254.169.254/latest/meta-data",
        "http://10.0.0.1/v1",
        "https://evil.example/v1",
        "http://127.0.0.1.evil.example/v1",
        "http://localhost.evil.example",
        "http://0.0.0.0:8700/v1",
        "http://[::ffff:127.0.0.1]/v1",
        "http://2130706433/v1",
        "http://127.1/v1",
    ):
        yield target.submit(_asks(endpoint))


@row("a language model with an invalid address", 422, says="/llm/endpoint", hides=("s3cret",))
def _no_address(target: Target) -> Iterable[Answer]:
    for endpoint in (
        "file:///etc/passwd",
        "gopher://127.0.0.1/",
        "http://user:s3cret@127.0.0.1/v1",
        "http://127.0.0.1:99999/v1",
        "http://127.0.0.1/v1?key=s3cret",
        "http://127.0.0.1/v1#x",
        "//127.0.0.1",
        "http://",
        "http://127.0.0.1/\r\nX: y",
        "http://127.0.0.1/v1/../admin",
        "http://127.0.0.1/v1/%2e%2e/",
        "http://127.0.0.1\\v1",
    ):
        yield target.submit(_asks(endpoint))


@row("an environment secret as a language model's key", 422, hides=("s3cret",))
def _environment(target: Target) -> Iterable[Answer]:
    for name in ("PATH", "BRINK_TOKEN", "AWS_SECRET_ACCESS_KEY"):
        yield target.submit(_asks("http://127.0.0.1:9/v1", api_key_env=name))
    yield target.submit(_asks("http://127.0.0.1:9/v1", api_key_env="sk-s3cret"))
    yield target.submit(_asks("http://127.0.0.1:9/v1", api_key="s3cret"))


@row("a system file as a data set", 422, says="/problem/params/dataset", hides=("root:", "PATH="))
def _datasets(target: Target) -> Iterable[Answer]:
    for name in (
        "/etc/passwd",
        "../../../../../../etc/passwd",
        "/proc/self/environ",
        "/proc/self/mem",
        "/proc/kmsg",
        "/dev/zero",
        "/dev/stdin",
        "/",
        "",
        "\0",
        "x" * 5000,
        "http://127.0.0.1:9/x.json",
        "file:///etc/passwd",
    ):
        yield target.submit(_measures(dataset=name))


@row("a system file as a detector", 422, says="/problem/params/detector", hides=("root:", "PATH="))
def _detectors(target: Target) -> Iterable[Answer]:
    for name in (
        "onnx:/dev/zero",
        "onnx:/proc/self/environ",
        "torchscript:/",
        "onnx:",
        "onnx:\0",
        "onnx:" + "x" * 5000,
        "ultralytics:http://127.0.0.1:9/x.pt",
        "pickle:/etc/passwd",
        "os:system",
        "../x",
        "",
    ):
        yield target.submit(_measures(detector=name))


@row("a Python module as a problem or an algorithm", 422, says="unknown")
def _modules(target: Target) -> Iterable[Answer]:
    for name in ("os:system", "builtins.eval", "../ball@1", "ball@1;", "ball@99", "BALL@1", " ball@1"):
        yield target.submit({**ball(seed=9), "problem": {"id": name}})
        yield target.submit({**ball(seed=9), "algorithm": {"id": name}})


def _measures(**params: str) -> dict[str, Any]:
    return {
        **ball(seed=9),
        "problem": {"id": "aeb-crossing@1", "params": params},
        "algorithm": {"id": "random@1"},
    }


REACH: tuple[Attack, ...] = (_elsewhere, _no_address, _environment, _datasets, _detectors, _modules)
