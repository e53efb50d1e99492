"""Messages between coordinator and workers: plain JSON, one model per message.

A worker in any language needs three requests: lease, heartbeat and results. Times are durations in seconds, and only
the coordinator's clock decides.
"""

import functools
import json
import os
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field

WIRE_VERSION = 1
MAX_DEPTH = 32
"""Deepest nesting of JSON values in a result."""

MAX_NAMED = 64
"""Most verdicts, and most objectives, of a result."""

LARGEST_NUMBER = 1e100
"""Largest number that a result may have in either direction: sums of squares of such numbers are finite."""
LONGEST_S = 1e9
"""Largest simulated time of a result, in seconds."""

NO_NUL = r"^[^\x00]*$"
"""Pattern of text that every database can store."""

Number = Annotated[float, Field(ge=-LARGEST_NUMBER, le=LARGEST_NUMBER, allow_inf_nan=False)]

LeaseToken = Annotated[
    str,
    Field(min_length=1, max_length=64, pattern=r"^[!-~]+$", description="Identifies one lease of one job."),
]
JobNumber = Annotated[int, Field(ge=0, le=2**63 - 1)]


class Message(BaseModel):
    """Base class of all messages: unknown fields are rejected, values are immutable."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class WorkerIdentity(Message):
    """The worker that makes a request."""

    id: Annotated[
        str,
        Field(
            min_length=1,
            max_length=64,
            pattern=NO_NUL,
            description="Unique and constant for the life of the process.",
        ),
    ]
    host: Annotated[str, Field(max_length=255, pattern=NO_NUL)] = ""
    pid: Annotated[int, Field(ge=0, le=2**63 - 1)] = 0
    version: Annotated[
        str, Field(max_length=64, pattern=NO_NUL, description="Version of the worker's software.")
    ] = ""
    machine: Annotated[
        str,
        Field(
            max_length=128,
            pattern=NO_NUL,
            description="Boot id and PID namespace of the process. A coordinator on the same machine looks up `pid` "
            "and takes back the leases of a dead process at once. If this is empty, it never does.",
        ),
    ] = ""


class LeaseRequest(Message):
    """A request for jobs, which waits up to `wait_s` for one to arrive."""

    worker: WorkerIdentity
    capabilities: Annotated[
        list[Annotated[str, Field(min_length=1, max_length=128, pattern=NO_NUL)]],
        Field(max_length=256, description="What this worker can run: simulator ids, detector ids, `vision`."),
    ]
    max_jobs: Annotated[int, Field(ge=1, le=256)] = 8
    wait_s: Annotated[float, Field(ge=0, le=60)] = 20.0


class LeasedJob(Message):
    """A job that is leased to one worker."""

    job: int
    token: LeaseToken
    attempt: Annotated[int, Field(ge=1, description="1 on the first try.")]
    spec: Annotated[dict[str, Any], Field(description="The EpisodeSpec to run.")]
    record: Annotated[bool, Field(description="Whether the result must carry the trace.")] = False
    timeout_s: Annotated[float, Field(gt=0, description="Wall-clock limit of the episode.")]
    campaign: Annotated[str, Field(max_length=64, description="The job's campaign, for logs.")] = ""


class LeaseReply(Message):
    """The jobs that were granted, possibly none."""

    jobs: list[LeasedJob]
    lease_s: Annotated[float, Field(gt=0, description="How long each lease lasts unless it is renewed.")]
    drain: Annotated[
        bool,
        Field(
            exclude_if=lambda drain: not drain,  # older workers do not know it
            description="Whether the worker is to finish the jobs that it holds, ask for no more, and exit.",
        ),
    ] = False


class HeldLease(Message):
    """A lease that a worker believes it holds."""

    job: JobNumber
    token: LeaseToken


class HeartbeatRequest(Message):
    """A request to renew leases, due at least every third of `lease_s`."""

    worker: WorkerIdentity
    leases: Annotated[list[HeldLease], Field(max_length=512)]


class HeartbeatReply(Message):
    """The jobs that are still held; the worker must drop all others."""

    held: list[int]
    lease_s: float


def _plain_json(value: dict[str, Any]) -> dict[str, Any]:
    """Reject values that cannot be written as JSON again: deep nesting, lone surrogates, NaN.

    Raises:
        ValueError: The value is nested too deeply or is not JSON.
    """
    level: list[Any] = [value]
    for _ in range(MAX_DEPTH):
        level = [inner for item in level for inner in _children(item)]
        if not level:
            break
    else:
        raise ValueError(f"expected at most {MAX_DEPTH} levels of nesting")
    try:
        json.dumps(value, allow_nan=False, ensure_ascii=False).encode()
    except (TypeError, ValueError) as error:
        raise ValueError(f"expected plain JSON: {error}") from None
    return value


def _children(item: object) -> Iterable[Any]:
    if isinstance(item, dict):
        return item.values()
    return item if isinstance(item, list | tuple) else ()


JsonValues = Annotated[dict[str, Any], AfterValidator(_plain_json)]
ValueName = Annotated[str, Field(min_length=1, max_length=128, pattern=NO_NUL)]


def _few(value: object) -> object:
    """Reject a large object before each of its values is checked, which takes a hostile one half a second.

    Raises:
        ValueError: The object has more than `MAX_NAMED` entries.
    """
    if isinstance(value, dict) and len(value) > MAX_NAMED:
        raise ValueError(f"expected at most {MAX_NAMED} entries, got {len(value)}")
    return value


class WireVerdict(Message):
    """The verdict of one requirement on an episode."""

    robustness: Annotated[Number, Field(description="Negative if violated.")]
    unit: Annotated[str, Field(max_length=16)]
    violated_at_s: Annotated[float, Field(ge=0, le=LONGEST_S, allow_inf_nan=False)] | None


class Completed(Message):
    """The outcome of an episode that ran to its end."""

    kind: Literal["completed"] = "completed"
    verdicts: Annotated[dict[ValueName, WireVerdict], Field(max_length=MAX_NAMED), BeforeValidator(_few)]
    objectives: Annotated[dict[ValueName, Number], Field(max_length=MAX_NAMED), BeforeValidator(_few)] = (
        Field(default_factory=dict)
    )
    features: Annotated[JsonValues, Field(max_length=256)] = Field(default_factory=dict)
    provenance: Annotated[JsonValues, Field(max_length=64)] = Field(default_factory=dict)
    trace: Annotated[str, Field(max_length=8_000_000, description="The npz trace in base64.")] | None = None


class JobFailed(Message):
    """The outcome of an episode without a verdict."""

    kind: Literal["failed"] = "failed"
    reason: Annotated[
        Literal["crashed", "timeout", "out-of-memory", "invalid", "error"],
        Field(description="`invalid` is final; every other reason is retried."),
    ]
    message: Annotated[str, Field(max_length=4000)]


Outcome: TypeAlias = Annotated[Completed | JobFailed, Field(discriminator="kind")]


class JobResult(Message):
    """The outcome of one leased job."""

    job: JobNumber
    token: LeaseToken
    outcome: Outcome


class ResultsRequest(Message):
    """A request that reports outcomes, releases leases, and may lease the next jobs."""

    worker: WorkerIdentity
    results: Annotated[list[JobResult], Field(max_length=256)]
    release: Annotated[
        list[HeldLease],
        Field(
            max_length=512, description="Leases of jobs that were not run; releasing them costs no attempt."
        ),
    ] = Field(default_factory=list)
    lease: LeaseRequest | None = None


class ResultStatus(Message):
    """The response to one reported outcome."""

    job: int
    status: Annotated[
        Literal["accepted", "invalid", "duplicate", "stale"],
        Field(
            description="`invalid`: the result lacks what its campaign needs, so the attempt failed. `duplicate`: "
            "already stored. `stale`: the lease was lost; nothing changed."
        ),
    ]


class ResultsReply(Message):
    """One status for each reported outcome, in order, and the next lease if it was requested."""

    statuses: list[ResultStatus]
    lease: LeaseReply | None = None


@functools.cache
def machine_name() -> str:
    """Return `WorkerIdentity.machine` of this process: two processes share it only if they share process ids.

    It names this boot of this kernel and the PID namespace; a host name is not enough, since containers and clones of
    virtual machines share host names. The result is empty on systems that provide neither.
    """
    try:
        boot_id = Path("/proc/sys/kernel/random/boot_id").read_text().strip()
        return f"{boot_id} {os.readlink('/proc/self/ns/pid')}"
    except OSError:
        return ""
