"""The Kubernetes manifests and docker-compose.yml, read as a cluster, an autoscaler or Compose reads them."""

import json
import math
import re
from collections.abc import Iterator, Mapping
from copy import deepcopy
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Final

import yaml
from prometheus_client.parser import text_string_to_metric_families

ROOT: Final = Path(__file__).resolve().parents[2]
KUBERNETES: Final = ROOT / "deploy" / "kubernetes"
SCHEMAS: Final = Path(__file__).resolve().parents[1] / "data" / "schemas"
_VARIABLE: Final = re.compile(
    r"\$(?:(?P<escaped>\$)|\{(?P<name>\w+)(?::(?P<operator>[-?])(?P<argument>[^}]*))?\})"
)
_SELECTION: Final = r"(?P<metric>\w+)(?:\{(?P<matchers>[^}]*)\})?"
_QUERY: Final = re.compile(
    rf"max\({_SELECTION}\)|sum\(max by \((?P<by>\w+)\) \({_SELECTION.replace('P<', 'P<of_')}\)\)"
)
_MATCHER: Final = re.compile(r'(\w+)(=~|=)"([^"]*)"')


class MissingVariable(Exception):
    """A variable of docker-compose.yml that must be set is not set."""


@cache
def _documents(path: Path) -> tuple[dict[str, Any], ...]:
    """Return what a YAML file holds; nobody changes it."""
    return tuple(yaml.safe_load_all(path.read_text()))


def manifests(kustomization: Path = KUBERNETES) -> Iterator[dict[str, Any]]:
    """Yield the resources that a kustomization applies, with its namespace-wide images and patches left out."""
    for name in _documents(kustomization / "kustomization.yaml")[0]["resources"]:
        yield from _documents(kustomization / name)


def all_manifests() -> Iterator[tuple[Path, dict[str, Any]]]:
    """Yield every resource, also of files that are applied only on demand, with its file."""
    for path in sorted(KUBERNETES.rglob("*.yaml")):
        for document in _documents(path):
            if document["kind"] not in ("Kustomization", "Component"):
                yield path, document


def resource(kind: str, name: str) -> dict[str, Any]:
    """Return one resource."""
    [one] = [d for _, d in all_manifests() if (d["kind"], d["metadata"].get("name")) == (kind, name)]
    return one


def pod_specs() -> dict[str, dict[str, Any]]:
    """Return the specification of every pod, by the kind and name of the resource that starts it."""
    found = {}
    for _, document in all_manifests():
        spec = document.get("spec", {})
        spec = spec.get("jobTemplate", {}).get("spec", spec)
        if "template" in spec:
            metadata = document["metadata"]
            name = metadata.get("name", metadata.get("generateName"))
            found[f"{document['kind']} {name}"] = spec["template"]["spec"]
    return found


def pod(deployment: str) -> dict[str, Any]:
    """Return the specification of the pods of a Deployment."""
    return pod_specs()[f"Deployment {deployment}"]


def container(deployment: str) -> dict[str, Any]:
    """Return the only container of the pods of a Deployment."""
    [one] = pod(deployment)["containers"]
    only: dict[str, Any] = one
    return only


def with_data() -> Iterator[dict[str, Any]]:
    """Yield the resources after the patches of the component `data`."""
    folder = KUBERNETES / "data"
    patches = _documents(folder / "kustomization.yaml")[0]["patches"]
    yield from manifests(folder)
    for document in manifests():
        patched = deepcopy(document)
        for patch in patches:
            target = patch["target"]
            if (target["kind"], target["name"]) == (document["kind"], document["metadata"].get("name")):
                for operation in yaml.safe_load(patch["patch"]):
                    _add(patched, operation)
        yield patched


def _add(document: dict[str, Any], operation: Mapping[str, Any]) -> None:
    """Apply one "add" of a JSON patch (RFC 6902) that adds a member to an object."""
    assert operation["op"] == "add", operation
    *parents, last = operation["path"].strip("/").split("/")
    place: Any = document
    for name in parents:
        place = place[int(name)] if isinstance(place, list) else place[name]
    assert isinstance(place, dict)
    assert last not in place, f"{operation['path']} would be replaced"
    place[last] = operation["value"]


def compose(environment: Mapping[str, str]) -> dict[str, Any]:
    """Return docker-compose.yml with its variables replaced, as `docker compose config` does.

    Raises:
        MissingVariable: A variable that must be set is not set.
    """
    replaced: dict[str, Any] = _interpolated(_documents(ROOT / "docker-compose.yml")[0], environment)
    return replaced


def _interpolated(value: Any, environment: Mapping[str, str]) -> Any:
    if isinstance(value, dict):
        return {key: _interpolated(item, environment) for key, item in value.items()}
    if isinstance(value, list):
        return [_interpolated(item, environment) for item in value]
    if not isinstance(value, str):
        return value

    def replace(found: re.Match[str]) -> str:
        if found["escaped"]:
            return "$"
        given = environment.get(found["name"], "")
        if not given and found["operator"] == "?":
            raise MissingVariable(f"{found['name']}: {found['argument']}")
        return given or (found["argument"] if found["operator"] == "-" else "")

    return _VARIABLE.sub(replace, value)


def schema_of(document: Mapping[str, Any]) -> dict[str, Any]:
    """Return the JSON schema of a resource's kind, which allows no unknown fields."""
    schemas = json.loads((SCHEMAS / "kubernetes.json").read_text())
    kind = schemas["kinds"][f"{document['apiVersion']} {document['kind']}"]
    return {"$ref": f"#/$defs/{kind}", "$defs": schemas["$defs"]}


def evaluate(query: str, exposition: str) -> float | None:
    """Return the value of a PromQL query on what one coordinator exposes, None if there is none.

    Args:
        query: ``max(METRIC{…})`` or ``sum(max by (LABEL) (METRIC{…}))`` with ``=`` and ``=~`` matchers.
        exposition: The text of ``/metrics``.

    Raises:
        ValueError: The query has another form.
    """
    parsed = _QUERY.fullmatch(query.strip())
    if parsed is None:
        raise ValueError(f"this test cannot evaluate {query!r}")
    by, prefix = parsed["by"], "of_" if parsed["by"] else ""
    largest: dict[str, float] = {}
    for labels, value in _series(exposition, parsed[f"{prefix}metric"], parsed[f"{prefix}matchers"] or ""):
        group = labels.get(by, "") if by else ""
        largest[group] = max(value, largest.get(group, -math.inf))
    return sum(largest.values()) if largest else None


def _series(exposition: str, metric: str, matchers: str) -> Iterator[tuple[dict[str, str], float]]:
    wanted = _MATCHER.findall(matchers)
    if ", ".join(f'{label}{sign}"{value}"' for label, sign, value in wanted) != matchers:
        raise ValueError(f"this test cannot evaluate {matchers!r}")
    for family in text_string_to_metric_families(exposition):
        for sample in family.samples:
            matches = all(
                re.fullmatch(value if sign == "=~" else re.escape(value), sample.labels.get(label, ""))
                for label, sign, value in wanted
            )
            if sample.name == metric and matches:
                yield sample.labels, sample.value


@dataclass(frozen=True, slots=True, kw_only=True)
class Scaling:
    """One ScaledObject: what KEDA and the autoscaler make of the value of its query, without their delays.

    Attributes:
        deployment: Name of the Deployment that it scales.
        query: The query of its only trigger.
        threshold: Jobs for each worker.
        smallest: Least number of replicas.
        largest: Greatest number of replicas.
    """

    deployment: str
    query: str
    threshold: float
    smallest: int
    largest: int

    def replicas(self, exposition: str) -> int:
        """Return the number of replicas for what the coordinator exposes."""
        value = evaluate(self.query, exposition)
        assert value is not None, f"{self.query} has no value, so KEDA would leave the number as it is"
        if value <= 0:
            return self.smallest
        return max(1, self.smallest, min(self.largest, math.ceil(value / self.threshold)))


def scalings() -> dict[str, Scaling]:
    """Return all ScaledObjects by the Deployment that they scale."""
    found = {}
    for document in manifests():
        if document["kind"] != "ScaledObject":
            continue
        spec = document["spec"]
        [trigger] = spec["triggers"]
        metadata = trigger["metadata"]
        assert float(metadata["activationThreshold"]) == 0
        name = spec["scaleTargetRef"]["name"]
        found[name] = Scaling(
            deployment=name,
            query=metadata["query"],
            threshold=float(metadata["threshold"]),
            smallest=spec["minReplicaCount"],
            largest=spec["maxReplicaCount"],
        )
    return found


def extras_of_images() -> dict[str, tuple[str, ...]]:
    """Return what is installed in each image that the manifests name, by the documented `docker build` commands."""
    built = _build_commands((ROOT / "docs" / "how-to" / "run-with-docker.md").read_text())
    images = _documents(KUBERNETES / "kustomization.yaml")[0]["images"]
    return {image["name"]: built[image["newTag"]] for image in images}


def _build_commands(page: str) -> dict[str, tuple[str, ...]]:
    """Return the extras of each image by its tag, from the `docker build` commands in a page of the documentation."""
    default = re.search(r"^ARG EXTRAS=(\S+)$", (ROOT / "Dockerfile").read_text(), re.MULTILINE)
    assert default is not None
    found = {}
    for line in re.findall(r"^docker build (.*) \.$", page, re.MULTILINE):
        tag = re.search(r"--tag \S+:(\S+)", line)
        extras = re.search(r"--build-arg EXTRAS=(\S+)", line)
        assert tag is not None
        found[tag[1]] = tuple((extras or default)[1].split(","))
    return found
