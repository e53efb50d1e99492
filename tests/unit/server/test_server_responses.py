"""How a response is written to its connection: the head and the beginning of the body in one piece, nothing lost."""

import asyncio
from collections.abc import Callable, Iterable
from typing import Any, cast

import pytest

from brink.server.runtime.request_timeout import ResponseTransport

HEAD, BODY, MORE = b"HTTP/1.1 200 OK\r\n\r\n", b"some", b"more"


class Connection(asyncio.Transport):
    """A connection that keeps what it is told to send, one entry for each time."""

    def __init__(self) -> None:
        super().__init__()
        self.sent: list[bytes] = []
        self.closed = False

    def write(self, data: Any) -> None:
        self.sent.append(bytes(data))

    def writelines(self, list_of_data: Iterable[Any]) -> None:
        parts = list(map(bytes, list_of_data))
        assert all(parts), "some event loops never finish sending nothing"
        self.sent.append(b"".join(parts))

    def close(self) -> None:
        self.closed = True

    def is_closing(self) -> bool:
        return self.closed


class Loop:
    """An event loop of which only the next turn matters."""

    def __init__(self) -> None:
        self.next: list[Callable[[], None]] = []

    def call_soon(self, callback: Callable[[], None]) -> None:
        self.next.append(callback)

    def turn(self) -> None:
        due, self.next = self.next, []
        for callback in due:
            callback()


@pytest.fixture
def connection() -> Connection:
    return Connection()


@pytest.fixture
def loop() -> Loop:
    return Loop()


@pytest.fixture
def response(connection: Connection, loop: Loop) -> ResponseTransport:
    return response_on(connection, loop)


def response_on(connection: Connection, loop: Loop) -> ResponseTransport:
    return ResponseTransport(connection, connection.close, cast(asyncio.AbstractEventLoop, loop))


def test_head_and_body_are_sent_together(
    response: ResponseTransport, connection: Connection, loop: Loop
) -> None:
    response.write(HEAD)
    assert connection.sent == []
    response.write(BODY)
    response.write(MORE)
    loop.turn()
    assert connection.sent == [HEAD + BODY, MORE]


@pytest.mark.parametrize("body", [(), (b"",)], ids=["none", "empty"])
def test_a_head_without_a_body_is_sent_once(
    response: ResponseTransport, connection: Connection, loop: Loop, body: tuple[bytes, ...]
) -> None:
    for part in (HEAD, *body):
        response.write(part)
    loop.turn()
    assert b"".join(connection.sent) == HEAD


def test_a_head_does_not_wait_for_a_body_that_comes_later(
    response: ResponseTransport, connection: Connection, loop: Loop
) -> None:
    response.write(HEAD)
    loop.turn()
    assert connection.sent == [HEAD]
    response.write(BODY)
    assert connection.sent == [HEAD, BODY]


def test_a_head_is_sent_before_the_connection_ends(
    response: ResponseTransport, connection: Connection, loop: Loop
) -> None:
    response.write(HEAD)
    response.close()
    assert (connection.sent, connection.closed) == ([HEAD], True)
    loop.turn()
    assert connection.sent == [HEAD]


def test_nothing_is_sent_on_a_connection_that_has_ended(
    response: ResponseTransport, connection: Connection, loop: Loop
) -> None:
    response.write(HEAD)
    connection.close()
    loop.turn()
    assert connection.sent == []


def test_responses_on_one_connection_keep_their_order(connection: Connection, loop: Loop) -> None:
    response_on(connection, loop).write(HEAD)  # to a HEAD request
    loop.call_soon(
        lambda: response_on(connection, loop).write(MORE)
    )  # the next request is served a turn later
    loop.turn()
    loop.turn()
    assert connection.sent == [HEAD, MORE]
