"""What docs/how-to/write-a-worker.md shows works: its messages are of the wire, its example is a worker."""

import json
import re
import subprocess
import sys
from pathlib import Path

from fake_coordinator import FakeCoordinator, Fault
from working import ROOT

from brink.worker.wire import (
    Completed,
    HeartbeatReply,
    HeartbeatRequest,
    JobFailed,
    LeaseReply,
    LeaseRequest,
    Message,
    ResultsReply,
    ResultsRequest,
)

GUIDE = (ROOT / "docs" / "how-to" / "write-a-worker.md").read_text(encoding="utf-8")


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", GUIDE, flags=re.DOTALL)


def test_every_message_of_the_guide_is_of_the_wire() -> None:
    kinds: list[type[Message]] = [
        LeaseRequest,
        LeaseReply,
        HeartbeatRequest,
        HeartbeatReply,
        ResultsRequest,
        ResultsReply,
    ]
    examples = blocks("json")
    assert len(examples) == len(kinds)
    for kind, example in zip(kinds, examples, strict=True):
        message = kind.model_validate_json(example)
        assert message.model_dump(exclude_unset=True) == json.loads(example)


def test_the_example_of_the_guide_is_a_worker(tmp_path: Path) -> None:
    [source] = blocks("python")
    program_file = tmp_path / "minimal.py"
    program_file.write_text(source, encoding="utf-8")
    # The lost reply carried a lease, too: that job comes back when its lease runs out.
    with FakeCoordinator(lease_s=0.5) as coordinator:
        coordinator.faults["results"] += [Fault.DROP_REPLY, 503]
        good = [coordinator.add({"fog": fog}, simulator="my-simulator@1") for fog in (0.25, 1.5)]
        bad = coordinator.add({}, simulator="my-simulator@1")
        with subprocess.Popen([sys.executable, str(program_file), coordinator.url]) as program:
            try:
                coordinator.wait_for_all()
            finally:
                program.kill()
        outcomes = [coordinator.jobs[job].outcome for job in good]
        robustness = [o.verdicts["distance@1"].robustness for o in outcomes if isinstance(o, Completed)]
        assert robustness == [0.75, -0.5]
        failure = coordinator.jobs[bad].outcome
        assert isinstance(failure, JobFailed)
        assert "fog" in failure.message


def test_the_example_of_the_guide_leaves_when_it_is_not_admitted(tmp_path: Path) -> None:
    [source] = blocks("python")
    program_file = tmp_path / "minimal.py"
    program_file.write_text(source, encoding="utf-8")
    with FakeCoordinator(token="secret") as coordinator:
        done = subprocess.run(
            [sys.executable, str(program_file), coordinator.url],
            capture_output=True,
            text=True,
            timeout=30,
            check=False,
        )
    assert done.returncode == 1
    assert "a bearer token is needed" in done.stderr
