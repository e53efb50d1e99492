"""The files that deploy Brink against the schemas of Compose, Kubernetes, KEDA and the Prometheus operator."""

import json
from collections.abc import Callable
from copy import deepcopy
from typing import Any

import pytest
from jsonschema import Draft202012Validator
from support.manifests import SCHEMAS, all_manifests, compose, resource, schema_of, with_data

SECRETS = {"BRINK_TOKEN": "a-token", "POSTGRES_PASSWORD": "a-password"}
DOCUMENTS = [
    pytest.param(document, id=f"{path.name}-{document['kind']}-{document['metadata'].get('name', '')}")
    for path, document in all_manifests()
]


def complaints(document: dict[str, Any]) -> list[str]:
    errors = Draft202012Validator(schema_of(document)).iter_errors(document)
    return [f"{error.json_path}: {error.message[:200]}" for error in errors]


@pytest.mark.parametrize("document", DOCUMENTS)
def test_manifests_have_known_fields_of_the_right_types(document: dict[str, Any]) -> None:
    assert complaints(document) == []


def test_patched_manifests_have_known_fields_of_the_right_types() -> None:
    for document in with_data():
        assert complaints(document) == []


def test_the_schemas_find_misspelt_and_missing_fields() -> None:
    deployment = resource("Deployment", "brink-coordinator")
    assert complaints(deployment) == []
    changes: tuple[Callable[[dict[str, Any]], object], ...] = (
        lambda spec: spec["template"]["spec"].update(automountServiceAccountTokens=False),
        lambda spec: spec["template"]["spec"]["containers"][0].update(args="serve"),
        lambda spec: spec.pop("selector"),
        lambda spec: spec["template"]["spec"].update(restartPolicy="Sometimes"),
    )
    for change in changes:
        changed = deepcopy(deployment)
        change(changed["spec"])
        assert len(complaints(changed)) == 1


@pytest.mark.parametrize(
    "variables", [{}, {"BRINK_DATA": "/srv/data", "BRINK_TAG": "mine", "BRINK_EXTRAS": "postgres"}]
)
def test_compose_file_is_valid(variables: dict[str, str]) -> None:
    validator = Draft202012Validator(json.loads((SCHEMAS / "compose.json").read_text()))
    document = compose({**SECRETS, **variables})
    assert [error.message for error in validator.iter_errors(document)] == []
    document["services"]["worker"]["comand"] = []
    assert [error.json_path for error in validator.iter_errors(document)] == ["$.services.worker"]
