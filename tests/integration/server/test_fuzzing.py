"""The API against its own description: no answer breaks it, and none says that the server failed."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from support.api import coordinator

FUZZER = Path(sys.executable).with_name("schemathesis")
HOOKS = Path(__file__).parents[2] / "fuzzing"
CHECKS = "not_a_server_error,status_code_conformance,content_type_conformance,response_schema_conformance"


@pytest.mark.timeout(200)
@pytest.mark.parametrize("databases", ["sqlite"], indirect=True)
@pytest.mark.usefixtures("small_problems")
def test_no_request_breaks_the_description(database_url: str, tmp_path: Path) -> None:
    environment = {**os.environ, "SCHEMATHESIS_HOOKS": "schemathesis_hooks", "PYTHONPATH": str(HOOKS)}
    with coordinator(database_url) as client:
        command = [
            str(FUZZER), "run", f"{client.base_url}/openapi.json", "--checks", CHECKS, "--phases",
            "examples,coverage,fuzzing", "--max-examples", "30", "--seed", "1", "--request-timeout", "30",
        ]  # fmt: skip
        said = subprocess.run(
            command, env=environment, cwd=tmp_path, capture_output=True, text=True, timeout=150, check=False
        )
    assert said.returncode == 0, said.stdout[-6000:] + said.stderr[-2000:]
    assert "Tested: 32" in said.stdout
