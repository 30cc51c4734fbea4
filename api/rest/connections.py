"""HTTP connections with limits: how many there are, and how long a request may take to arrive.

uvicorn limits neither: a connection that says nothing, or a byte a minute, would be kept for ever, and one more file
descriptor than the process may have stops every answer. `connection_class` makes its protocol do both.
"""

from __future__ import annotations

import asyncio
import resource
from dataclasses import dataclass
from typing import Any, ClassVar

import h11
import structlog
from uvicorn.protocols.http.h11_impl import H11Protocol

log = structlog.get_logger("api.connections")

# Kept for files, the database, planners and flights, whatever the limit of open files is.
_OWN_DESCRIPTORS = 128
# So many connections are accepted in one go, before the first of them can be turned away.
BACKLOG = 64
_TOLD_EVERY_S = 10.0


@dataclass(frozen=True)
class Limits:
    """How long what is awaited of the other side may take, and how many ``connections`` there may be at once.

    ``headers_s``: from connecting, or the answer before, to the end of a request's head; ``body_s``: from there to the
    end of its body; ``reading_s``: an answer that nobody reads waits so long.
    """

    headers_s: float
    body_s: float
    reading_s: float
    connections: int


def possible_connections(wanted: int) -> int:
    """``wanted``, or what the limit on open files leaves room for, which is raised as far as this process may."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    needed = wanted + BACKLOG + _OWN_DESCRIPTORS
    if soft != resource.RLIM_INFINITY and soft < needed:
        soft = needed if hard == resource.RLIM_INFINITY else min(needed, hard)
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
    room = wanted if soft == resource.RLIM_INFINITY else soft - BACKLOG - _OWN_DESCRIPTORS
    return max(8, min(wanted, room))


class _Connection(H11Protocol):
    """One connection; what all of them share is the class's, see `connection_class`."""

    limits: ClassVar[Limits]
    open_now: ClassVar[set[asyncio.BaseTransport]]
    watching: ClassVar[set[asyncio.Task[None]]]
    told_s: ClassVar[list[float]]

    def __init__(self, *arguments: Any, **named: Any) -> None:
        super().__init__(*arguments, **named)
        self._deadline: asyncio.TimerHandle | None = None
        self._awaited = ""
        self._unread: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        if len(self.open_now) >= self.limits.connections:
            if self.loop.time() - self.told_s[0] >= _TOLD_EVERY_S:
                self.told_s[0] = self.loop.time()
                log.warning("connections are turned away", open=len(self.open_now))
            transport.abort()
        self.open_now.add(transport)
        super().connection_made(transport)
        self._await("head", self.limits.headers_s)

    def connection_lost(self, exc: Exception | None) -> None:
        self.open_now.discard(self.transport)
        self._await("", 0.0)
        self._read_again()
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        super().data_received(data)
        self._look()

    def on_response_complete(self) -> None:
        super().on_response_complete()
        self._look()

    def handle_websocket_upgrade(self, event: h11.Request) -> None:
        self._await("", 0.0)
        transport = self.transport
        super().handle_websocket_upgrade(event)
        # Its own protocol hears of the end from now on.
        task = self.loop.create_task(_until_closed(transport, self.open_now))
        self.watching.add(task)
        task.add_done_callback(self.watching.discard)

    def pause_writing(self) -> None:
        super().pause_writing()
        self._unread = self.loop.call_later(self.limits.reading_s, self.transport.abort)

    def resume_writing(self) -> None:
        self._read_again()
        super().resume_writing()

    def _read_again(self) -> None:
        if self._unread is not None:
            self._unread.cancel()
            self._unread = None

    def _look(self) -> None:
        """What of the request is still to come, and by when."""
        if self.conn.their_state is h11.IDLE:
            self._await("head", self.limits.headers_s)
        elif self.conn.their_state is h11.SEND_BODY:
            self._await("body", self.limits.body_s)
        else:
            self._await("", 0.0)

    def _await(self, what: str, seconds: float) -> None:
        if what == self._awaited:
            return
        self._awaited = what
        if self._deadline is not None:
            self._deadline.cancel()
            self._deadline = None
        if what:
            self._deadline = self.loop.call_later(seconds, self._too_late)

    def _too_late(self) -> None:
        log.info("a request took too long to arrive", awaited=self._awaited)
        self._deadline = None
        self.transport.abort()


def connection_class(limits: Limits) -> type[asyncio.Protocol]:
    """uvicorn's protocol for HTTP with ``limits``, shared by all its connections."""
    shared = {"limits": limits, "open_now": set(), "watching": set(), "told_s": [-_TOLD_EVERY_S]}
    return type("Connection", (_Connection,), shared)


async def _until_closed(transport: asyncio.Transport, open_now: set[asyncio.BaseTransport]) -> None:
    while not transport.is_closing():
        await asyncio.sleep(1.0)
    open_now.discard(transport)
