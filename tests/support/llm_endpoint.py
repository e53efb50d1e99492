"""A fake language model endpoint behind a real socket: it imitates the usual servers, including their faults.

Its answers are scripted, one step per request, and it records the requests.
"""

import asyncio
import inspect
import json
import socket
import threading
from collections import deque
from collections.abc import AsyncIterator, Awaitable, Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

import httpx
import uvicorn
from fastapi import FastAPI, Request
from fastapi.responses import JSONResponse, Response, StreamingResponse

from brink.server.llm.access import LlmAccess
from brink.server.llm.settings import LlmSettings

MODEL = "test-model"
USAGE = {"prompt_tokens": 900, "completion_tokens": 100, "total_tokens": 1000}
PATIENCE_S = 15.0


class Server(StrEnum):
    """The server to imitate."""

    VLLM = "vllm"
    LLAMA_CPP = "llama.cpp"
    OLLAMA = "ollama"


class ErrorForm(StrEnum):
    """The form of an error body."""

    OPENAI = "openai"
    DETAIL = "detail"
    DETAILS = "details"
    WORD = "word"
    HTML = "html"


@dataclass(frozen=True)
class Asked:
    """A request received by the endpoint."""

    path: str
    headers: Mapping[str, str]
    body: Any

    @property
    def form(self) -> str:
        """How the request specified the form of the reply."""
        stated = self.body.get("response_format") or {"type": "plain"}
        return "schema_in_object" if "schema" in stated else str(stated["type"])

    @property
    def prompt(self) -> str:
        """All messages as text."""
        return json.dumps(self.body["messages"])


Step = Callable[[Asked], Response | Awaitable[Response]]


def completion(text: Any, server: Server = Server.VLLM, finish: str | None = "stop") -> dict[str, Any]:
    """Return a chat completion in the format of a server."""
    message: dict[str, Any] = {"role": "assistant", "content": text}
    choice: dict[str, Any] = {"index": 0, "message": message, "finish_reason": finish}
    body: dict[str, Any] = {
        "id": "chatcmpl-1",
        "object": "chat.completion",
        "created": 1_800_000_000,
        "model": MODEL,
        "choices": [choice],
        "usage": dict(USAGE),
    }
    match server:
        case Server.VLLM:
            message |= {"reasoning_content": None, "tool_calls": []}
            choice |= {"logprobs": None, "stop_reason": None}
            body["usage"]["prompt_tokens_details"] = None
            body |= {"prompt_logprobs": None, "kv_transfer_params": None}
        case Server.LLAMA_CPP:
            body |= {
                "system_fingerprint": "b6000",
                "timings": {"prompt_ms": 12.5, "predicted_per_second": 40.1},
            }
        case Server.OLLAMA:
            body["system_fingerprint"] = "fp_ollama"
            del body["usage"]
    return body


def says(text: Any, *, server: Server = Server.VLLM, finish: str | None = "stop", **changes: Any) -> Step:
    """Return a step that answers with a text."""
    body = {**completion(text, server, finish), **changes}
    return gives(body)


def gives(body: Any, status: int = 200) -> Step:
    """Return a step that answers with a body."""
    return lambda asked: JSONResponse(body, status)


def error_body(message: str, form: ErrorForm) -> Any:
    """Return an error body in one of the usual forms."""
    match form:
        case ErrorForm.OPENAI:
            return {
                "error": {"message": message, "type": "invalid_request_error", "param": None, "code": None}
            }
        case ErrorForm.DETAIL:
            return {"detail": message}
        case ErrorForm.DETAILS:
            return {"detail": [{"loc": ["body"], "msg": message, "type": "value_error"}]}
        case ErrorForm.WORD:
            return {"error": message}
        case ErrorForm.HTML:
            return f"<html><body>{message}</body></html>"


def refuses(status: int, message: str = "no", form: ErrorForm = ErrorForm.OPENAI, **headers: str) -> Step:
    """Return a step that answers with an error."""
    body = error_body(message, form)
    named = {name.replace("_", "-"): value for name, value in headers.items()}
    if isinstance(body, str):
        return lambda asked: Response(body, status, named, media_type="text/html")
    return lambda asked: JSONResponse(body, status, named)


def late(step: Step, delay_s: float) -> Step:
    """Return a step that answers like another one, after some time."""

    async def answer(asked: Asked) -> Response:
        await asyncio.sleep(delay_s)
        response = step(asked)
        return await response if inspect.isawaitable(response) else response

    return answer


def cut(text: str) -> Step:
    """Return a step that announces a longer body than it sends, and closes the connection."""

    async def part() -> AsyncIterator[bytes]:
        yield json.dumps(completion(text)).encode()[:-40]

    length = len(json.dumps(completion(text)).encode())
    return lambda asked: StreamingResponse(
        part(), media_type="application/json", headers={"Content-Length": str(length)}
    )


def huge(size: int) -> Step:
    """Return a step that answers with a body of about the given size, in chunks."""

    async def chunks() -> AsyncIterator[bytes]:
        for _ in range(size // 65536 + 1):
            yield b" " * 65536

    return lambda asked: StreamingResponse(chunks(), media_type="application/json")


@dataclass
class Endpoint:
    """The script of the endpoint, and the requests that it received.

    Attributes:
        url: Base URL.
        asked: Requests received, oldest first.
        forms: Forms of a reply that it accepts.
        form_refusal: Its answer to requests for other forms.
        key: Required API key, if any.
        models: Body of the model list; None if it has no list.
        always: Its answer when the script has ended; by default, an error that names the test.
    """

    url: str
    asked: list[Asked] = field(default_factory=list)
    forms: Collection[str] = ("json_schema", "schema_in_object", "json_object", "plain")
    form_refusal: Step = field(
        default_factory=lambda: refuses(400, "'response_format.type' must be one of: text")
    )
    key: str | None = None
    models: Any = None
    always: Step = field(default_factory=lambda: refuses(418, "the test has no further answer"))
    _steps: deque[Step] = field(default_factory=deque)
    _stalled: list[tuple[asyncio.AbstractEventLoop, asyncio.Event]] = field(default_factory=list)

    def then(self, *steps: Step) -> None:
        """Add steps for the next requests."""
        self._steps.extend(steps)

    def stalls(self) -> Step:
        """Return a step that does not answer until `release` is called."""

        async def stalled(asked: Asked) -> Response:
            event = asyncio.Event()
            self._stalled.append((asyncio.get_running_loop(), event))
            await asyncio.wait_for(event.wait(), PATIENCE_S)
            return JSONResponse(completion("too late"))

        return stalled

    def release(self) -> None:
        """Release stalled answers."""
        for loop, event in self._stalled:
            loop.call_soon_threadsafe(event.set)
        self._stalled.clear()

    def reset(self) -> None:
        """Reset the script, and forget all requests."""
        self.release()
        fresh = Endpoint(self.url)
        for name in ("asked", "forms", "form_refusal", "key", "models", "always", "_steps"):
            setattr(self, name, getattr(fresh, name))

    async def chat(self, request: Request) -> Response:
        """Handle a chat completion request."""
        asked = Asked(request.url.path, dict(request.headers), await request.json())
        self.asked.append(asked)
        if (refusal := self._wrong_key(asked.headers)) is not None:
            return refusal
        if asked.form not in self.forms:
            step = self.form_refusal
        else:
            step = self._steps.popleft() if self._steps else self.always
        response = step(asked)
        return await response if inspect.isawaitable(response) else response

    async def list_models(self, request: Request) -> Response:
        """Handle a request for the list of models."""
        if (refusal := self._wrong_key(request.headers)) is not None:
            return refusal
        if self.models is None:
            return JSONResponse({"detail": "Not Found"}, 404)
        return JSONResponse(self.models)

    def _wrong_key(self, headers: Mapping[str, str]) -> Response | None:
        came = headers.get("authorization", "").removeprefix("Bearer ")
        if self.key is None or came == self.key:
            return None
        # Some gateways quote a rejected key.
        return JSONResponse({"error": {"message": f"Incorrect API key provided: {came}."}}, 401)


@contextmanager
def serving() -> Iterator[Endpoint]:
    """Run an endpoint on a thread of this process."""
    listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM, socket.IPPROTO_TCP)
    listener.bind(("127.0.0.1", 0))
    listener.listen(64)
    endpoint = Endpoint(f"http://127.0.0.1:{listener.getsockname()[1]}/v1")
    app = FastAPI(openapi_url=None)
    app.add_api_route("/v1/chat/completions", endpoint.chat, methods=["POST"], response_model=None)
    app.add_api_route("/v1/models", endpoint.list_models, methods=["GET"], response_model=None)
    config = uvicorn.Config(app, log_config=None, access_log=False, lifespan="off", ws="none")
    server = uvicorn.Server(config)
    thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]}, name="llm-endpoint")
    thread.start()
    try:
        yield endpoint
    finally:
        endpoint.release()
        server.should_exit = True
        thread.join(PATIENCE_S)
        listener.close()


def unencrypted() -> httpx.AsyncHTTPTransport:
    """Return an HTTP transport without certificates, which take longer to load than a test."""
    return httpx.AsyncHTTPTransport(verify=False)


def llm_settings(endpoint: Endpoint, **changes: Any) -> LlmSettings:
    """Return settings for an endpoint."""
    given = {"endpoint": endpoint.url, "model": MODEL, "timeout_s": PATIENCE_S, "retries": 2, **changes}
    return LlmSettings.model_validate(given)


def access_to(settings: LlmSettings, environ: Mapping[str, str] | None = None) -> LlmAccess:
    """Return what an operator allows who trusts an endpoint with the key in ``MY_KEY``."""
    return LlmAccess.parse(f"{settings.endpoint} MY_KEY", environ or {})


def action(name: str = "keep", duration_s: float = 2.0, magnitude: float = 0.0) -> dict[str, Any]:
    """Return an action as a model writes it."""
    return {"action": name, "duration_s": duration_s, "magnitude": magnitude}


def participant(**changes: Any) -> dict[str, Any]:
    """Return a car ahead that brakes, as a model writes it."""
    return {
        "kind": "car",
        "ds_m": 25.0,
        "dd_m": 0.0,
        "heading": "with_ego",
        "speed_mps": 8.0,
        "actions": [action("keep"), action("brake", 2.0, 6.0)],
        **changes,
    }


def item(**changes: Any) -> dict[str, Any]:
    """Return a solution with one car, as a model writes it."""
    return {"participants": [participant(**changes)]}


def items(count: int, first: int = 0) -> list[dict[str, Any]]:
    """Return different valid solutions, as a model writes them."""
    return [item(ds_m=20.0 + number) for number in range(first, first + count)]


def reply_text(solutions: Sequence[Any]) -> str:
    """Return the text of a reply with the given solutions."""
    return json.dumps({"solutions": list(solutions)})
