"""The files under deploy/ and docker-compose.yml use existing options, variables, ports, paths and metrics."""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
import typer
import yaml
from prometheus_client.parser import text_string_to_metric_families
from support.api import ball, submit

from brink.cli.commands import app
from brink.server.settings import Settings
from brink.server.states import JobKind, JobStatus
from brink.sim.catalogue import PLUGINS_VARIABLE
from brink.worker.log import FORMAT_VARIABLE, LEVEL_VARIABLE
from brink.worker.loop import LAST_REPORT_S
from brink.worker.settings import TOKEN_VARIABLE

ROOT = Path(__file__).resolve().parents[3]
KUBERNETES = ROOT / "deploy" / "kubernetes"
DOCS = (ROOT / "docs" / "how-to" / "run-many-workers.md").read_text()
GROUP: Any = typer.main.get_command(app)
COMMANDS = {name: GROUP.get_command(None, name) for name in GROUP.list_commands(None)}
MARGIN_S = 5.0
"""Time for the shutdown to start and for processes to end."""


def documents() -> Iterator[dict[str, Any]]:
    for path in sorted(KUBERNETES.glob("*.yaml")):
        yield from yaml.safe_load_all(path.read_text())


def resource(kind: str, name: str) -> dict[str, Any]:
    [one] = [d for d in documents() if d["kind"] == kind and d["metadata"]["name"] == name]
    return one


def pod(name: str) -> dict[str, Any]:
    spec: dict[str, Any] = resource("Deployment", name)["spec"]["template"]["spec"]
    return spec


def container(name: str) -> dict[str, Any]:
    [one] = pod(name)["containers"]
    only: dict[str, Any] = one
    return only


def compose(service: str) -> dict[str, Any]:
    document = yaml.safe_load((ROOT / "docker-compose.yml").read_text())
    spec: dict[str, Any] = document["services"][service]
    return spec


def options(command: list[str]) -> dict[str, str]:
    """Return the options of a command line, after checking that the command has them."""
    name, *rest = command
    known = {option for parameter in COMMANDS[name].params for option in parameter.opts}
    used = dict(zip(rest[::2], rest[1::2], strict=True))
    assert set(used) <= known, f"brink {name} has no {set(used) - known}"
    return used


def known_variables() -> set[str]:
    settings = {f"BRINK_{name.upper()}" for name in Settings.model_fields}
    commands = {p.envvar for command in COMMANDS.values() for p in getattr(command, "params", ()) if p.envvar}
    return settings | commands | {PLUGINS_VARIABLE, TOKEN_VARIABLE, FORMAT_VARIABLE, LEVEL_VARIABLE}


WORKERS = {
    "kubernetes": (container("brink-worker")["args"], pod("brink-worker")["terminationGracePeriodSeconds"]),
    "compose": (compose("worker")["command"], int(compose("worker")["stop_grace_period"].removesuffix("s"))),
}
COORDINATORS = {
    "kubernetes": container("brink-coordinator")["args"],
    "compose": compose("coordinator")["command"],
}


@pytest.mark.parametrize("where", WORKERS)
def test_workers_have_time_to_finish_and_know_the_coordinator(where: str) -> None:
    command, grace_s = WORKERS[where]
    used = options(command)
    assert grace_s >= float(used["--grace-s"]) + LAST_REPORT_S + MARGIN_S
    server = httpx.URL(used["--server"])
    assert server.port == int(options(COORDINATORS[where])["--port"])
    if where == "kubernetes":
        service = resource("Service", server.host)
        assert service["spec"]["ports"][0]["port"] == server.port
        assert service["spec"]["selector"].items() <= _labels("brink-coordinator").items()
    else:
        assert compose(server.host)["command"] == COORDINATORS[where]


def test_compose_can_run_any_number_of_workers() -> None:
    worker = compose("worker")
    assert not {"container_name", "ports", "hostname"} & set(worker), "these must be unique"


@pytest.mark.parametrize("where", COORDINATORS)
def test_the_coordinator_listens_on_the_published_port(where: str) -> None:
    used = options(COORDINATORS[where])
    assert used["--host"] == "0.0.0.0"
    if where == "compose":
        assert any(mapping.endswith(f":{used['--port']}") for mapping in compose("coordinator")["ports"])
        return
    [port] = container("brink-coordinator")["ports"]
    assert port["containerPort"] == int(used["--port"])
    assert resource("Service", "brink-coordinator")["spec"]["ports"][0]["targetPort"] == port["name"]


def test_probes_use_endpoints_of_the_coordinator(client: httpx.Client) -> None:
    probes = {name: probe for name, probe in container("brink-coordinator").items() if name.endswith("Probe")}
    assert set(probes) == {"startupProbe", "livenessProbe", "readinessProbe"}
    for probe in probes.values():
        assert probe["httpGet"]["port"] == "http"
        assert client.get(probe["httpGet"]["path"]).status_code == 200
    assert probes["readinessProbe"]["httpGet"]["path"] == "/readyz"
    [path] = re.findall(
        r"http://127\.0\.0\.1:8700(/\w+)", " ".join(compose("coordinator")["healthcheck"]["test"])
    )
    assert client.get(path).status_code == 200


def test_every_variable_is_read_by_brink() -> None:
    variables = {
        variable["name"]
        for name in ("brink-coordinator", "brink-worker")
        for variable in container(name)["env"]
    }
    variables |= {key for service in ("coordinator", "worker") for key in compose(service)["environment"]}
    assert variables <= known_variables()


def test_every_secret_is_documented() -> None:
    texts = [path.read_text() for path in KUBERNETES.glob("*.yaml")]
    secrets = {pair for text in texts for pair in re.findall(r"\{name: (brink-\w+), key: (\w+)\}", text)}
    assert secrets == {
        ("brink-database", "url"), ("brink-tokens", "admin"), ("brink-tokens", "worker"), ("brink-tokens", "read"),
    }  # fmt: skip
    for name, key in secrets:
        assert name in DOCS
        assert f"--from-literal={key}=" in DOCS or rf"\"{key}\"" in DOCS, f"{name} {key}"


def test_all_files_are_applied_and_use_the_same_image() -> None:
    kustomization = yaml.safe_load((KUBERNETES / "kustomization.yaml").read_text())
    files = {path.name for path in KUBERNETES.glob("*.yaml")} - {"kustomization.yaml"}
    assert set(kustomization["resources"]) == files
    [image] = kustomization["images"]
    assert {container(name)["image"] for name in ("brink-coordinator", "brink-worker")} == {image["name"]}
    for name in ("brink-coordinator", "brink-worker"):
        assert pod(name)["securityContext"]["runAsUser"] == 1000
    assert "useradd --create-home --uid 1000" in (ROOT / "Dockerfile").read_text()


def test_scaling_queries_existing_metrics(client: httpx.Client) -> None:
    submit(client, ball())
    scaled = resource("ScaledObject", "brink-worker")["spec"]
    assert resource("Deployment", scaled["scaleTargetRef"]["name"])["spec"].get("replicas") is None, (
        "KEDA sets the number"
    )
    assert scaled["minReplicaCount"] == 0
    [trigger] = scaled["triggers"]
    query = trigger["metadata"]["query"]
    monitor = resource("ServiceMonitor", "brink-coordinator")["spec"]
    [endpoint] = monitor["endpoints"]
    assert (
        monitor["selector"]["matchLabels"].items()
        <= resource("Service", "brink-coordinator")["metadata"]["labels"].items()
    )
    assert endpoint["port"] == resource("Service", "brink-coordinator")["spec"]["ports"][0]["name"]

    text = client.get(endpoint["path"]).text
    labels = {
        family.name: {label for sample in family.samples for label in sample.labels}
        for family in text_string_to_metric_families(text)
    }
    queried = re.findall(r"max by \(([\w, ]+)\) \((\w+)(?:\{([^}]*)\})?\)", query)
    assert {metric for _, metric, _ in queried} == {"brink_queue_depth", "brink_jobs"}
    for by, metric, matchers in queried:
        expected = {*by.split(", "), *re.findall(r"(\w+)=~?", matchers)}
        assert expected == labels[metric], "the sum covers all labels except that of the process"
    assert re.search(r'kind="(\w+)"', query)[1] == JobKind.TRACE  # type: ignore[index]
    open_states = re.search(r'status=~"([\w|]+)"', query)[1].split("|")  # type: ignore[index]
    assert set(open_states) == {JobStatus.QUEUED, JobStatus.LEASED}


def test_the_guide_to_many_machines_uses_existing_worker_options() -> None:
    known = {option for parameter in COMMANDS["worker"].params for option in parameter.opts}
    used = [set(re.findall(r"(?<!\S)--[a-z-]+", line)) for line in re.findall(r"brink worker([^`\n]*)", DOCS)]
    assert {"--server", "--ray"} <= set().union(*used) <= known


def _labels(deployment: str) -> dict[str, str]:
    spec = resource("Deployment", deployment)["spec"]
    labels: dict[str, str] = spec["template"]["metadata"]["labels"]
    assert spec["selector"]["matchLabels"].items() <= labels.items()
    return labels
