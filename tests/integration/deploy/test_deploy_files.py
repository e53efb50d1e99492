"""The files under deploy/ and docker-compose.yml use existing options, variables, ports, paths and images."""

import re
import tomllib
from typing import Any

import httpx
import pytest
import typer
import yaml
from support.manifests import (
    KUBERNETES,
    ROOT,
    MissingVariable,
    all_manifests,
    compose,
    container,
    extras_of_images,
    manifests,
    pod,
    pod_specs,
    resource,
    with_data,
)

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


def test_compose_can_run_any_number_of_workers() -> None:
    assert not {"container_name", "ports", "hostname"} & set(service("worker")), "these must be unique"


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


def test_every_secret_is_documented() -> None:
    texts = [path.read_text() for path in KUBERNETES.glob("*.yaml")]
    secrets = {pair for text in texts for pair in re.findall(r"\{name: (brink-\w+), key: (\w+)", text)}
    assert secrets == {
        ("brink-database", "url"),
        ("brink-tokens", "admin"),
        ("brink-tokens", "worker"),
        ("brink-tokens", "read"),
        ("brink-llm", "endpoints"),
        ("brink-llm", "key"),
    }
    page = PAGES["run-on-kubernetes"]
    for name, key in secrets:
        assert name in page
        assert f"--from-literal={key}=" in page or rf"\"{key}\"" in page, f"{name} {key}"


def test_all_files_are_applied_or_documented_as_optional() -> None:
    text = (KUBERNETES / "kustomization.yaml").read_text()
    applied = set(yaml.safe_load(text)["resources"])
    optional = set(re.findall(r"^  # - (\S+)", text, re.MULTILINE))
    files = {path.name for path in KUBERNETES.glob("*.yaml")} - {"kustomization.yaml", "restore.yaml"}
    assert optional == {"ingress.yaml"}
    assert applied | optional == files
    assert re.search(r"^components: \[\] +# \[(\w+)\]", text, re.MULTILINE)[1] == "data"  # type: ignore[index]
    for name in ("ingress.yaml", "restore.yaml", "components: [data]"):
        assert name in PAGES["run-on-kubernetes"]


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


def test_pods_run_where_there_is_a_simulator() -> None:
    """PyBullet has wheels for x86-64 only."""
    for name, spec in pod_specs().items():
        images = {one["image"] for one in (*spec.get("initContainers", ()), *spec["containers"])}
        if any(image.startswith("brink") for image in images):
            assert spec["nodeSelector"] == {"kubernetes.io/arch": "amd64"}, name
    assert {service(name)["platform"] for name in ("coordinator", "worker")} == {"linux/amd64"}


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


def test_the_ingress_is_encrypted_and_leads_to_the_coordinator() -> None:
    spec = resource("Ingress", "brink")["spec"]
    [rule] = spec["rules"]
    assert spec["tls"][0]["hosts"] == [rule["host"]]
    [path] = rule["http"]["paths"]
    found = resource("Service", path["backend"]["service"]["name"])
    assert path["backend"]["service"]["port"]["name"] == found["spec"]["ports"][0]["name"]
    assert "brink.example.org" in PAGES["run-on-kubernetes"]


def test_data_is_at_the_same_path_everywhere() -> None:
    assert "/data" in (ROOT / "Dockerfile").read_text()
    for name in ("coordinator", "worker"):
        [volume] = service(name)["volumes"]
        assert volume.endswith(":/data:ro")
    mounted = {}
    for document in with_data():
        if document["kind"] == "Deployment":
            spec = document["spec"]["template"]["spec"]
            mounts = spec["containers"][0].get("volumeMounts", [])
            assert {mount["name"] for mount in mounts} == {
                volume["name"] for volume in spec.get("volumes", [])
            }
            mounted[document["metadata"]["name"]] = {mount["mountPath"] for mount in mounts}
    assert mounted == {
        "brink-coordinator": {"/data"},
        "brink-worker-vision": {"/data"},
        "brink-worker": set(),
    }


def test_compose_says_which_variable_is_missing() -> None:
    for name in SECRETS:
        with pytest.raises(MissingVariable, match=f"{name}: set {name} to a secret"):
            compose({key: value for key, value in SECRETS.items() if key != name})


def test_the_services_of_compose_refer_to_each_other() -> None:
    document = compose(SECRETS)
    for one in document["services"].values():
        assert set(one.get("depends_on", {})) <= set(document["services"])
        for other, condition in one.get("depends_on", {}).items():
            assert condition == {"condition": "service_healthy"}
            assert "healthcheck" in document["services"][other]
        for volume in one.get("volumes", ()):
            source = volume.partition(":")[0]
            assert source.startswith((".", "/")) or source in document["volumes"]


def test_variables_of_compose_are_documented() -> None:
    used = set(re.findall(r"\$\{(\w+)", (ROOT / "docker-compose.yml").read_text()))
    assert {name for name in used if name not in PAGES["run-with-docker"]} == set()


def test_the_guides_use_existing_worker_options() -> None:
    known = {option for parameter in COMMANDS["worker"].params for option in parameter.opts}
    lines = [line for page in PAGES.values() for line in re.findall(r"brink worker([^`\n]*)", page)]
    used = [set(re.findall(r"(?<!\S)--[a-z-]+", line)) for line in lines]
    assert {"--server", "--ray"} <= set().union(*used) <= known


def test_a_resource_is_declared_once() -> None:
    names = [(d["kind"], d["metadata"].get("name")) for _, d in all_manifests()]
    assert len(names) == len(set(names))


def _labels(deployment: str) -> dict[str, str]:
    spec = resource("Deployment", deployment)["spec"]
    labels: dict[str, str] = spec["template"]["metadata"]["labels"]
    assert spec["selector"]["matchLabels"].items() <= labels.items()
    return labels


def _trigger(deployment: str) -> dict[str, Any]:
    [trigger] = resource("ScaledObject", deployment)["spec"]["triggers"]
    only: dict[str, Any] = trigger
    return only
