"""The API against its OpenAPI description: made-up requests never cause a server error or an undescribed answer.

The fuzzer is told the ids of campaigns, jobs, leases and solutions that exist (`support.populated`). With made-up ids
alone it would hardly see anything but "no such campaign".
"""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import httpx
import pytest
from support.api import listening_coordinator, progress
from support.populated import fill

FUZZER = Path(sys.executable).with_name("schemathesis")
HOOKS = Path(__file__).parents[2] / "fuzzing"
CHECKS = "not_a_server_error,status_code_conformance,content_type_conformance,response_schema_conformance"
METHODS = {"get", "post", "put", "patch", "delete"}
PICTURES = {
    "/campaigns/{campaign_id}/pairs/{safe}-{unsafe}/{side}.png",
    "/campaigns/{campaign_id}/solutions/{number}/compared/{side}.png",
}
"""Pictures of drives that a worker has to record first, which the workers of this test cannot."""
MAY_BE_UNAVAILABLE = PICTURES | {
    "/campaigns/{campaign_id}/solutions/{number}/episode",
    "/campaigns/{campaign_id}/solutions/{number}/trace",
    "/campaigns/{campaign_id}/solutions/{number}/replay.{extension}",
}


@pytest.mark.timeout(400)
@pytest.mark.usefixtures("small_problems")
@pytest.mark.long("tries many requests")
def test_generated_requests_are_answered(database_url: str, tmp_path: Path) -> None:
    with listening_coordinator(database_url, lease_s=3600) as client:
        known = fill(client)
        paths = client.get("/openapi.json").json()["paths"]
        operations = sum(len(METHODS & of_path.keys()) for of_path in paths.values())
        before = {campaign: digest(client, campaign) for campaign in known["campaigns"][:3]}
        environment = {
            **os.environ,
            "SCHEMATHESIS_HOOKS": "schemathesis_hooks",
            "PYTHONPATH": str(HOOKS),
            "BRINK_FUZZ_KNOWN": json.dumps(known),
        }
        command = [
            str(FUZZER),
            "--config-file",
            str(HOOKS / "schemathesis.toml"),
            "run",
            f"{client.base_url}/openapi.json",
            "--checks",
            CHECKS,
            "--phases",
            "examples,coverage,fuzzing",
            "--max-examples",
            "30",
            "--seed",
            "1",
            "--request-timeout",
            "30",
        ]
        fuzzer = subprocess.run(
            command, env=environment, cwd=tmp_path, capture_output=True, text=True, timeout=300, check=False
        )
        answered = answers(client)
        after = {campaign: digest(client, campaign) for campaign in before}
        ready = client.get("/readyz").status_code
    assert fuzzer.returncode == 0, fuzzer.stdout[-6000:] + fuzzer.stderr[-2000:]
    assert f"Tested: {operations}" in fuzzer.stdout, fuzzer.stdout[-1000:]
    assert after == before, "a finished campaign changed"
    assert ready == 200
    assert {route for route, status in answered if status == "5xx"} <= MAY_BE_UNAVAILABLE
    with_ids = {route for route, _ in answered if "{" in route}
    found = {route for route, status in answered if status == "2xx"}
    assert len(with_ids) >= 18
    assert with_ids - PICTURES <= found, "some requests were made with made-up ids alone"


def digest(client: httpx.Client, campaign: str) -> str:
    """Return the archive digest of a finished campaign."""
    return str(progress(client, campaign)["digest"])


def answers(client: httpx.Client) -> set[tuple[str, str]]:
    """Return the pairs of route and class of status that were answered so far."""
    counted = r'^brink_request_seconds_count{method="[A-Z]+",route="([^"]+)",status="(\dxx)"}'
    return set(re.findall(counted, client.get("/metrics").text, re.MULTILINE))
