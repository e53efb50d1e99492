"""What a campaign suggests next is driven by the campaign's own driving system."""

import json
from types import SimpleNamespace
from typing import Any
from urllib.parse import parse_qs

import pytest

from brink.server.findings.tolerances.kind import _search


@pytest.mark.parametrize(
    ("params", "driving"),
    [
        ({}, {}),
        ({"driving": "modular@1", "driving_settings": {}}, {}),
        ({"driving": "idm:Idm", "driving_settings": {}}, {"driving": "idm:Idm"}),
        (
            {"driving": "idm:Idm", "driving_settings": {"headway_s": 2}},
            {"driving": "idm:Idm", "driving_settings": {"headway_s": 2}},
        ),
    ],
)
def test_search_for_tolerances_has_the_driving_system_of_the_campaign(
    params: dict[str, Any], driving: dict[str, Any]
) -> None:
    problem = SimpleNamespace(params={"requirement": "front-gap@1", **params})
    campaign: Any = SimpleNamespace(body=SimpleNamespace(name="mine", problem=problem))
    (body,) = parse_qs(str(_search(campaign, "urban-errors@1").place).partition("?")[2])["body"]
    assert json.loads(body)["problem"]["params"] == {"errors": 1, "requirement": "front-gap@1", **driving}
