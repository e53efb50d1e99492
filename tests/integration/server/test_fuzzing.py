"""The API against its own description: no answer breaks it, and none says that the server failed.

The fuzzer knows of campaigns, jobs, leases and solutions that are really there (`support.fuzzed`): with made-up ids
alone it would hardly come past "no such campaign".
"""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import httpx
import pytest
from support.api import coordinator, progress
from support.fuzzed import fill

FUZZER = Path(sys.executable).with_name("schemathesis")
HOOKS = Path(__file__).parents[2] / "fuzzing"
CHECKS = "not_a_server_error,status_code_conformance,content_type_conformance,response_schema_conformance"
MAY_BE_UNAVAILABLE = {
    "/campaigns/{campaign_id}/solutions/{number}/episode",
    "/campaigns/{campaign_id}/solutions/{number}/trace",
    "/campaigns/{campaign_id}/solutions/{number}/replay.{extension}",
}


@pytest.mark.timeout(200)
@pytest.mark.parametrize("databases", ["sqlite"], indirect=True)
@pytest.mark.usefixtures("small_problems")
def test_no_request_breaks_the_description(database_url: str, tmp_path: Path) -> None:
    with coordinator(database_url, lease_s=3600) as client:
        known = fill(client)
        before = {campaign: digest(client, campaign) for campaign in known["campaigns"][:3]}
        environment = {
            **os.environ, "SCHEMATHESIS_HOOKS": "schemathesis_hooks", "PYTHONPATH": str(HOOKS),
            "BRINK_FUZZ_KNOWN": json.dumps(known),
        }  # fmt: skip
        command = [
            str(FUZZER), "--config-file", str(HOOKS / "schemathesis.toml"), "run",
            f"{client.base_url}/openapi.json", "--checks", CHECKS, "--phases", "examples,coverage,fuzzing",
            "--max-examples", "30", "--seed", "1", "--request-timeout", "30",
        ]  # fmt: skip
        said = subprocess.run(
            command, env=environment, cwd=tmp_path, capture_output=True, text=True, timeout=150, check=False
        )
        answered = answers(client)
        after = {campaign: digest(client, campaign) for campaign in before}
        ready = client.get("/readyz").status_code
    assert said.returncode == 0, said.stdout[-6000:] + said.stderr[-2000:]
    assert "Tested: 55" in said.stdout
    assert after == before, "what has ended stays what it is"
    assert ready == 200
    assert {route for route, status in answered if status == "5xx"} <= MAY_BE_UNAVAILABLE
    named = {route for route, _ in answered if "{" in route}
    assert len(named) >= 18
    assert {route for route, status in answered if status == "2xx"} >= named, (
        "made-up ids alone would do no good"
    )


def digest(client: httpx.Client, campaign: str) -> str:
    """Return the digest of a campaign that has ended."""
    return str(progress(client, campaign)["digest"])


def answers(client: httpx.Client) -> set[tuple[str, str]]:
    """Return which routes answered with which kind of status."""
    counted = r'^brink_request_seconds_count{method="[A-Z]+",route="([^"]+)",status="(\dxx)"}'
    return set(re.findall(counted, client.get("/metrics").text, re.MULTILINE))
