"""The wire between coordinator and workers: plain JSON, one model a message.

A worker in any language needs three requests: lease, heartbeat, results. Times are durations in seconds; the
coordinator's clock alone decides.
"""

import json
from collections.abc import Iterable
from typing import Annotated, Any, Literal, TypeAlias

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

WIRE_VERSION = 1
NO_NUL = r"^[^\x00]*$"
"""Text that every database can store."""
LeaseToken = Annotated[
    str, Field(min_length=1, max_length=64, pattern=r"^[!-~]+$", description="Names one lease of one job.")
]
JobNumber = Annotated[int, Field(ge=0, le=2**63 - 1)]


class Message(BaseModel):
    """Base of every message: unknown fields are refused, values are immutable."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class WorkerIdentity(Message):
    """Who asks."""

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
            description="Boot id and PID namespace of the process. A coordinator of the same machine looks `pid` up "
            "and takes the leases of a dead process back at once; empty: it never does.",
        ),
    ] = ""


class LeaseRequest(Message):
    """Ask for jobs; waits up to `wait_s` for one to arrive."""

    worker: WorkerIdentity
    capabilities: Annotated[
        list[Annotated[str, Field(min_length=1, max_length=128, pattern=NO_NUL)]],
        Field(max_length=256, description="What this worker can run: simulator ids, detector ids, `vision`."),
    ]
    max_jobs: Annotated[int, Field(ge=1, le=256)] = 8
    wait_s: Annotated[float, Field(ge=0, le=60)] = 20.0


class LeasedJob(Message):
    """One job, leased to one worker."""

    job: int
    token: LeaseToken
    attempt: Annotated[int, Field(ge=1, description="1 on the first try.")]
    spec: Annotated[dict[str, Any], Field(description="The EpisodeSpec to run.")]
    record: Annotated[bool, Field(description="Whether the result must carry the trace.")] = False
    timeout_s: Annotated[float, Field(gt=0, description="Wall-clock time after which to give up.")]
    campaign: Annotated[str, Field(max_length=64, description="Whose it is, for logs.")] = ""


class LeaseReply(Message):
    """The jobs that were granted, perhaps none."""

    jobs: list[LeasedJob]
    lease_s: Annotated[float, Field(gt=0, description="How long each lease holds unless it is renewed.")]


class HeldLease(Message):
    """A lease that a worker believes it holds."""

    job: JobNumber
    token: LeaseToken


class HeartbeatRequest(Message):
    """Renew leases, at least every third of `lease_s`."""

    worker: WorkerIdentity
    leases: Annotated[list[HeldLease], Field(max_length=512)]


class HeartbeatReply(Message):
    """The jobs that are still held; drop all others."""

    held: list[int]
    lease_s: float


MAX_DEPTH = 32


def _plain_json(value: dict[str, Any]) -> dict[str, Any]:
    """Refuse what cannot be written as JSON again: nesting without end, half a surrogate pair, NaN."""
    level: list[Any] = [value]
    for _ in range(MAX_DEPTH):
        level = [inner for item in level for inner in _inside(item)]
        if not level:
            break
    else:
        raise ValueError(f"expected at most {MAX_DEPTH} levels of nesting")
    try:
        json.dumps(value, allow_nan=False, ensure_ascii=False).encode()
    except (TypeError, ValueError) as error:
        raise ValueError(f"expected plain JSON: {error}") from None
    return value


def _inside(item: object) -> Iterable[Any]:
    if isinstance(item, dict):
        return item.values()
    return item if isinstance(item, list | tuple) else ()


JsonValues = Annotated[dict[str, Any], AfterValidator(_plain_json)]


ValueName = Annotated[str, Field(min_length=1, max_length=128, pattern=NO_NUL)]


class WireVerdict(Message):
    """What a requirement says of an episode."""

    robustness: Annotated[float, Field(allow_inf_nan=False, description="Negative if violated.")]
    unit: Annotated[str, Field(max_length=16)]
    violated_at_s: Annotated[float, Field(ge=0, allow_inf_nan=False)] | None


class Completed(Message):
    """An episode that ran to its end."""

    kind: Literal["completed"] = "completed"
    verdicts: Annotated[dict[ValueName, WireVerdict], Field(max_length=64)]
    objectives: Annotated[
        dict[ValueName, Annotated[float, Field(allow_inf_nan=False)]], Field(max_length=64)
    ] = Field(default_factory=dict)
    features: Annotated[JsonValues, Field(max_length=256)] = Field(default_factory=dict)
    provenance: Annotated[JsonValues, Field(max_length=64)] = Field(default_factory=dict)
    trace: Annotated[str, Field(max_length=8_000_000, description="Base64 of the npz trace.")] | None = None


class JobFailed(Message):
    """An episode that gave no verdict."""

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
    """Report outcomes, give leases back, and ask for the next lease in the same request."""

    worker: WorkerIdentity
    results: Annotated[list[JobResult], Field(max_length=256)]
    release: Annotated[
        list[HeldLease],
        Field(max_length=512, description="Leases handed back unrun, without a charge to their attempts."),
    ] = Field(default_factory=list)
    lease: LeaseRequest | None = None


class ResultStatus(Message):
    """What became of one reported outcome."""

    job: int
    status: Annotated[
        Literal["accepted", "duplicate", "stale"],
        Field(description="`duplicate`: stored before. `stale`: the lease was lost; nothing changed."),
    ]


class ResultsReply(Message):
    """One status for each reported outcome, in order, and the next lease if one was asked for."""

    statuses: list[ResultStatus]
    lease: LeaseReply | None = None
