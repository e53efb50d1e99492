"""A stand-in for a language model: a local OpenAI-compatible endpoint that answers with hand-written patterns.

No trained model is behind it. What a search finds with its seeds shows that the path works (prompts, calls, checks of
replies, repair turns, seeds that are sent back) and what it costs in calls and tokens, not what a model would find.

Each answer is drawn with a generator that depends on prompt and seed alone, so searches are reproducible. Every
`BROKEN_EVERY`-th solution of an answer has a speed that no road user reaches, and has to be repaired.
"""

import asyncio
import hashlib
import json
import re
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any, Final

import httpx
import numpy as np

from brink.search.algorithm import Proposal, SeedRequest
from brink.search.space import SearchSpace
from brink.search.traffic.constraint import participants_component
from brink.search.traffic.participants import RoadLimits
from brink.search.traffic.variation import TrafficGenome, hostile_solution, prolonged
from brink.server.llm.access import LlmAccess
from brink.server.llm.calls import tokens_of
from brink.server.llm.client import LlmClient
from brink.server.llm.replies import to_text
from brink.server.llm.seeds import ask
from brink.server.llm.settings import LlmSettings
from brink.server.problems.base import SupportsSeeds
from brink.server.seeding import LlmCall, Spent, spent_on

MODEL: Final = "stand-in"
BROKEN_EVERY: Final = 5
_MAX_CALLS: Final = 100_000
_TOO_FAST_MPS: Final = 99.0
_WANTED: Final = re.compile(r"Give (\d+) (?:further )?solutions?")
_KNOWN: Final = "# Known solutions"


def answer(request: Mapping[str, Any], road: RoadLimits, max_participants: int) -> str:
    """Return the reply to a prompt: patterns, extended by random actions if known ones are shown.

    Args:
        request: The body of a chat completion request, whose last message asks for a number of solutions.
        road: The road.
        max_participants: Maximum number of participants in a solution.

    Raises:
        ValueError: The last message does not ask for solutions.
    """
    asked = _WANTED.search(request["messages"][-1]["content"])
    if asked is None:
        raise ValueError("expected a prompt that asks for a number of solutions")
    prompt = json.dumps([request.get("seed"), request["messages"]])
    rng = np.random.default_rng(list(hashlib.sha256(prompt.encode()).digest()))
    genome = TrafficGenome.of(SearchSpace((participants_component("road_users", max_participants, road),)))
    drawn = [hostile_solution(road, max_participants, rng) for _ in range(int(asked[1]))]
    if _KNOWN in prompt:
        drawn = [tuple(prolonged(one, rng) for one in solution) for solution in drawn]
    reply = json.loads(to_text([genome.repaired(solution, rng) for solution in drawn]))
    for solution in reply["solutions"][BROKEN_EVERY - 1 :: BROKEN_EVERY]:
        solution["participants"][0]["speed_mps"] = _TOO_FAST_MPS
    return json.dumps(reply)


@contextmanager
def serving(road: RoadLimits, max_participants: int) -> Iterator[str]:
    """Serve the stand-in on a thread; yield the base URL of the endpoint."""

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            asked = self.rfile.read(int(self.headers["Content-Length"])).decode()
            text = answer(json.loads(asked), road, max_participants)
            body = json.dumps(_completion(text, len(asked))).encode()
            self.send_response(200)
            self.send_header("Content-Type", "application/json")
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

        def log_request(self, code: object = "-", size: object = "-") -> None:
            """Log nothing."""

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.05}, name=MODEL)
        thread.start()
        try:
            yield f"http://127.0.0.1:{server.server_address[1]}/v1"
        finally:
            server.shutdown()
            thread.join()


def _completion(text: str, prompt_chars: int) -> dict[str, Any]:
    """Return a chat completion; its usage is estimated from the numbers of characters."""
    message = {"role": "assistant", "content": text}
    return {
        "id": "chatcmpl-1",
        "object": "chat.completion",
        "created": 0,
        "model": MODEL,
        "choices": [{"index": 0, "message": message, "finish_reason": "stop"}],
        "usage": {"prompt_tokens": tokens_of(prompt_chars), "completion_tokens": tokens_of(len(text))},
    }


class _Calls:
    """The calls of a search, in memory. They are not dated: the circuit breaker never waits."""

    def __init__(self) -> None:
        self._calls: dict[tuple[int, int], LlmCall] = {}

    def read(self) -> tuple[list[LlmCall], datetime]:
        """Return all calls, and the current time."""
        return list(self._calls.values()), datetime.now(UTC)

    def store(self, call: LlmCall) -> None:
        """Store a call, replacing the same call while it was in progress."""
        self._calls[call.request, call.turn] = call


class StandInSeeds:
    """Seeds for one search, requested as a coordinator does, but without a database.

    Args:
        problem: The problem of the search.
        endpoint: Base URL of the stand-in.
        seed: Sampling seed, which every request has.

    Attributes:
        waited_s: Wall-clock time that requests took.
    """

    def __init__(self, problem: SupportsSeeds, endpoint: str, seed: int) -> None:
        self._problem = problem
        self._settings = LlmSettings(
            endpoint=endpoint, model=MODEL, seed=seed, max_calls=_MAX_CALLS, retries=0
        )
        self._calls = _Calls()
        self.waited_s = 0.0

    @property
    def spent(self) -> Spent:
        """Calls and tokens so far."""
        return spent_on(self._calls.read()[0])

    def proposals(self, request: SeedRequest) -> Sequence[Proposal]:
        """Return the usable solutions of the answer to a request, after a repair turn if there are errors."""
        began = time.perf_counter()
        found = asyncio.run(self._ask(request))
        self.waited_s += time.perf_counter() - began
        return found

    async def _ask(self, request: SeedRequest) -> Sequence[Proposal]:
        # Certificates, which this endpoint does not need, take longer to load than it takes to answer.
        async with LlmClient(
            self._settings, access=LlmAccess(), transport=httpx.AsyncHTTPTransport(verify=False)
        ) as client:
            answered = await ask(request, self._problem, self._calls, client)
        return answered.proposals
