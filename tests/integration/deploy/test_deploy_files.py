"""The files under deploy/ and docker-compose.yml use existing options, variables, ports, paths and images."""

import re
import tomllib
from typing import Any

import httpx
import pytest
import typer
from support.manifests import ROOT, compose, container, extras_of_images, manifests, pod, pod_specs, resource

from brink.cli.commands import app
from brink.server.settings import Settings
from brink.sim.catalogue import PLUGINS_VARIABLE
from brink.worker.alive_file import STUCK_S, TOUCH_S
from brink.worker.log import FORMAT_VARIABLE, LEVEL_VARIABLE
from brink.worker.loop import LAST_REPORT_S
from brink.worker.settings import TOKEN_VARIABLE

PAGES = {
    name: (ROOT / "docs" / "how-to" / f"{name}.md").read_text()
    for name in ("run-many-workers", "run-with-docker", "run-on-kubernetes")
}
GROUP: Any = typer.main.get_command(app)
COMMANDS = {name: GROUP.get_command(None, name) for name in GROUP.list_commands(None)}
SECRETS = {"BRINK_TOKEN": "a-token", "POSTGRES_PASSWORD": "a-password"}
KEY_VARIABLE = "LLM_API_KEY"
WORKERS = ("brink-worker", "brink-worker-vision")
MARGIN_S = 5.0
"""Time for the shutdown to start and for processes to end."""


def service(name: str) -> dict[str, Any]:
    spec: dict[str, Any] = compose(SECRETS)["services"][name]
    return spec


def options(command: list[str]) -> dict[str, str]:
    """Return the options of a command line, after checking that the command has them."""
    name, *rest = command
    known = {option for parameter in COMMANDS[name].params for option in parameter.opts}
    words = [word for one in rest for word in one.split("=", 1)]
    flags = {option for parameter in COMMANDS[name].params if parameter.is_flag for option in parameter.opts}
    used: dict[str, str] = {}
    while words:
        option = words.pop(0)
        used[option] = "" if option in flags else words.pop(0)
    assert set(used) <= known, f"brink {name} has no {set(used) - known}"
    return used


def known_variables() -> set[str]:
    settings = {f"BRINK_{name.upper()}" for name in Settings.model_fields}
    commands = {p.envvar for command in COMMANDS.values() for p in getattr(command, "params", ()) if p.envvar}
    own = {PLUGINS_VARIABLE, TOKEN_VARIABLE, FORMAT_VARIABLE, LEVEL_VARIABLE}
    return settings | commands | own | {KEY_VARIABLE}


STARTED = {
    **{name: (container(name)["args"], pod(name)["terminationGracePeriodSeconds"]) for name in WORKERS},
    "compose": (service("worker")["command"], int(service("worker")["stop_grace_period"].removesuffix("s"))),
}
COORDINATORS = {
    "kubernetes": container("brink-coordinator")["args"],
    "compose": service("coordinator")["command"],
}


@pytest.mark.parametrize("where", STARTED)
def test_workers_have_time_to_finish_and_know_the_coordinator(where: str) -> None:
    command, grace_s = STARTED[where]
    used = options(command)
    assert grace_s >= float(used["--grace-s"]) + LAST_REPORT_S + MARGIN_S
    server = httpx.URL(used["--server"])
    if where == "compose":
        assert server.port == int(options(COORDINATORS["compose"])["--port"])
        assert service(server.host)["command"] == COORDINATORS["compose"]
    else:
        assert server.port == int(options(COORDINATORS["kubernetes"])["--port"])
        found = resource("Service", server.host)
        assert found["spec"]["ports"][0]["port"] == server.port
        assert found["spec"]["selector"].items() <= _labels("brink-coordinator").items()


@pytest.mark.parametrize("where", STARTED)
def test_probes_of_workers_look_at_the_file_that_they_touch(where: str) -> None:
    file = options(STARTED[where][0])["--alive-file"]
    if where == "compose":
        probe = service("worker")["healthcheck"]["test"][1]
    else:
        assert container(where)["startupProbe"]["exec"]["command"] == ["test", "-e", file]
        *shell, probe = container(where)["livenessProbe"]["exec"]["command"]
        assert shell == ["sh", "-c"]
    found = re.fullmatch(r'test -n "\$\(find (\S+) -mmin -(\d+)\)"', probe)
    assert found is not None
    assert found[1] == file
    assert TOUCH_S * 4 <= int(found[2]) * 60 <= STUCK_S


@pytest.mark.parametrize("where", COORDINATORS)
def test_the_coordinator_listens_on_the_published_port(where: str) -> None:
    used = options(COORDINATORS[where])
    assert used["--host"] == "0.0.0.0"
    if where == "compose":
        [mapping] = service("coordinator")["ports"]
        assert mapping == f"127.0.0.1:{used['--port']}:{used['--port']}", "from this machine only"
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
    check = " ".join(service("coordinator")["healthcheck"]["test"])
    [path] = re.findall(r"http://127\.0\.0\.1:8700(/\w+)", check)
    assert client.get(path).status_code == 200


def test_every_variable_is_read_by_brink() -> None:
    variables = {
        variable["name"] for name in ("brink-coordinator", *WORKERS) for variable in container(name)["env"]
    }
    variables |= {key for name in ("coordinator", "worker") for key in service(name)["environment"]}
    assert variables <= known_variables()


def test_language_models_are_configured_for_the_coordinator_only() -> None:
    wanted = {"BRINK_LLM_ENDPOINTS", KEY_VARIABLE}
    assert wanted <= set(service("coordinator")["environment"])
    assert not wanted & set(service("worker")["environment"])
    given = {variable["name"]: variable for variable in container("brink-coordinator")["env"]}
    for name in wanted:
        assert given[name]["valueFrom"]["secretKeyRef"]["optional"], "most coordinators use none"
    for worker in WORKERS:
        assert not wanted & {variable["name"] for variable in container(worker)["env"]}
    for page in ("run-with-docker", "run-on-kubernetes"):
        assert f"api_key_env: {KEY_VARIABLE}" in PAGES[page]


def test_containers_use_images_that_are_built() -> None:
    built = extras_of_images()
    declared = set(tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"])
    assert all(set(extras) <= declared for extras in built.values())
    used = {
        container["image"]
        for spec in pod_specs().values()
        for container in (*spec.get("initContainers", ()), *spec["containers"])
    }
    assert used == {*built, "postgres:18"}
    assert all("postgres" in extras for extras in built.values())
    assert service("coordinator")["build"]["args"]["EXTRAS"] == ",".join(built["brink-vision"])


def test_pods_have_few_rights() -> None:
    dockerfile = (ROOT / "Dockerfile").read_text()
    assert "useradd --create-home --uid 1000" in dockerfile
    for name, spec in pod_specs().items():
        assert spec["automountServiceAccountToken"] is False, name
        context = spec["securityContext"]
        assert context["runAsNonRoot"]
        assert context["seccompProfile"] == {"type": "RuntimeDefault"}
        for one in (*spec.get("initContainers", ()), *spec["containers"]):
            own = one["securityContext"]
            assert own["allowPrivilegeEscalation"] is False
            assert own["capabilities"] == {"drop": ["ALL"]}
            user = own.get("runAsUser", context["runAsUser"])
            assert user == (999 if one["image"].startswith("postgres:") else 1000), f"{name} {one['name']}"
            assert {"requests", "limits"} <= set(one["resources"]), f"{name} {one['name']}"


def test_only_workers_and_prometheus_reach_the_coordinator() -> None:
    policies = {d["metadata"]["name"]: d["spec"] for d in manifests() if d["kind"] == "NetworkPolicy"}
    for document in manifests():
        if document["kind"] in ("Deployment", "CronJob"):
            template = document["spec"].get("jobTemplate", {}).get("spec", document["spec"])["template"]
            labels = template["metadata"]["labels"]
            assert policies["brink-closed"]["podSelector"]["matchLabels"].items() <= labels.items()
    assert "ingress" not in policies["brink-closed"]
    [rule] = policies["brink-coordinator"]["ingress"]
    pods, namespace = rule["from"]
    for name in WORKERS:
        labels = _labels(name)
        assert pods["podSelector"]["matchLabels"].items() <= labels.items()
        assert policies["brink-workers"]["podSelector"]["matchLabels"].items() <= labels.items()
    monitoring = httpx.URL(_trigger("brink-worker")["metadata"]["serverAddress"]).host.split(".")[1]
    assert namespace["namespaceSelector"]["matchLabels"]["kubernetes.io/metadata.name"] == monitoring
    assert rule["ports"] == [{"port": container("brink-coordinator")["ports"][0]["containerPort"]}]
    to_coordinator, to_names = policies["brink-workers"]["egress"]
    assert to_coordinator["ports"] == rule["ports"]
    assert (
        to_coordinator["to"][0]["podSelector"]["matchLabels"].items() <= _labels("brink-coordinator").items()
    )
    assert {port["port"] for port in to_names["ports"]} == {53}


def test_disruption_budgets_cover_all_deployments_and_let_nodes_be_drained() -> None:
    budgets = [d["spec"] for d in manifests() if d["kind"] == "PodDisruptionBudget"]
    for name in ("brink-coordinator", *WORKERS):
        [budget] = [b for b in budgets if b["selector"]["matchLabels"].items() <= _labels(name).items()]
        assert "minAvailable" not in budget, "one replica that must not go away would block its node"


def _labels(deployment: str) -> dict[str, str]:
    spec = resource("Deployment", deployment)["spec"]
    labels: dict[str, str] = spec["template"]["metadata"]["labels"]
    assert spec["selector"]["matchLabels"].items() <= labels.items()
    return labels


def _trigger(deployment: str) -> dict[str, Any]:
    [trigger] = resource("ScaledObject", deployment)["spec"]["triggers"]
    only: dict[str, Any] = trigger
    return only
