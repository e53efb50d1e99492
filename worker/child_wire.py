"""The messages between a worker and its simulation process, as the worker's side sees them.

The process sends one `Hello`; then the worker sends any number of `RunEpisode` ahead, and the process answers
each with one `EpisodeReply`, in the same order. The process itself reads and writes plain JSON
(`brink.worker.child`).
"""

from typing import Any

from brink.worker.wire import Message


class Hello(Message):
    """What the process can run, once it has imported it.

    Attributes:
        simulators: Ids of the simulators that can be made here.
        left_out: Why the others cannot, by id.
    """

    simulators: tuple[str, ...]
    left_out: dict[str, str]


class RunEpisode(Message):
    """Run one episode.

    Attributes:
        ticket: Comes back in the reply.
        spec: The `EpisodeSpec` as JSON.
        record: Whether the result must carry the trace.
    """

    ticket: int
    spec: dict[str, Any]
    record: bool


class EpisodeReply(Message):
    """What came out of one episode.

    Attributes:
        ticket: Of the request.
        wall_s: Wall-clock time that the episode took.
        outcome: A `Completed` or a `JobFailed`, read by `brink.worker.codec.outcome_from`.
    """

    ticket: int
    wall_s: float
    outcome: dict[str, Any]
