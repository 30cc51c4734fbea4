"""What every request passes: an id and a log line, HEAD, the limit on bodies.

Plain ASGI, so that streamed answers stay streamed. Order from outside in: `RequestLog`, `api.rest.guards`,
`HeadAnswers`, `BodyLimit`.
"""

from __future__ import annotations

import asyncio
import re
import time
import uuid
from collections.abc import Callable

import structlog
from starlette.requests import ClientDisconnect
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from api.rest import problems
from api.rest.problems import BodyTooLargeError

_REQUEST_ID = re.compile(r"[A-Za-z0-9._-]{1,64}")
# A body past the limit is read to its end (up to these) and thrown away, so that the client hears the answer
# instead of a reset connection.
_DRAIN_FACTOR = 40
_DRAIN_S = 10.0
_MISSIONS = re.compile(r"/v1/missions(/[^/]+/versions)?")

log = structlog.get_logger("api.http")

# method, route template, status, seconds
Observer = Callable[[str, str, int, float], None]


def header(scope: Scope, name: bytes) -> str | None:
    """The first value of a request header, ``name`` in lower case."""
    for key, value in scope["headers"]:
        if key == name:
            return str(value, "latin-1")
    return None


class RequestLog:
    """Gives each request an id, logs it, counts it, and turns a fault of ours into a 500 without its inner parts."""

    def __init__(self, app: ASGIApp, observe: Observer) -> None:
        self.app = app
        self.observe = observe

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one connection."""
        if scope["type"] not in ("http", "websocket"):
            await self.app(scope, receive, send)
            return
        asked = header(scope, b"x-request-id")
        request_id = asked if asked and _REQUEST_ID.fullmatch(asked) else uuid.uuid4().hex
        structlog.contextvars.clear_contextvars()
        structlog.contextvars.bind_contextvars(request_id=request_id)
        if scope["type"] == "websocket":
            await self.app(scope, receive, send)
            return
        started = time.monotonic()
        status = 0

        async def send_marked(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
                message["headers"] = [*message.get("headers", ()), (b"x-request-id", request_id.encode())]
            await send(message)

        try:
            await self.app(scope, receive, send_marked)
        except asyncio.CancelledError:
            if status:
                raise
            # The service ends, and its patience with this request is over.
            ending = problems.problem_details(503, "the service is ending", kind="unavailable", title="Not available")
            await problems.response(ending, {"connection": "close"})(scope, receive, send_marked)
        except ClientDisconnect:
            log.info("the client went away", method=scope["method"], path=scope["path"])
        except Exception:
            log.exception("fault", method=scope["method"], path=scope["path"])
            if status:
                raise  # the answer is under way: cutting the connection is the only way left to say so
            await problems.response(problems.fault_details())(scope, receive, send_marked)
        finally:
            seconds = time.monotonic() - started
            route = getattr(scope.get("route"), "path", "(none)")
            self.observe(scope["method"], route, status, seconds)
            level = log.debug if route in ("/healthz", "/readyz", "/metrics") else log.info
            level("request", method=scope["method"], path=scope["path"], status=status, ms=round(seconds * 1e3, 1))


class HeadAnswers:
    """Answers HEAD as GET without its body, wherever GET is answered; a stream is left as soon as its head is known."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one connection."""
        if scope["type"] != "http" or scope["method"] != "HEAD":
            await self.app(scope, receive, send)
            return
        asked: Scope = {**scope, "method": "GET"}
        known = asyncio.Event()
        head: list[Message] = []

        async def keep(message: Message) -> None:
            if message["type"] == "http.response.start":
                head.append(message)
            elif head:
                known.set()

        getting = asyncio.ensure_future(self.app(asked, receive, keep))
        waiting = asyncio.ensure_future(known.wait())
        try:
            await asyncio.wait({getting, waiting}, return_when=asyncio.FIRST_COMPLETED)
            if getting.done():
                getting.result()
        finally:
            waiting.cancel()
            getting.cancel()
            await asyncio.gather(getting, waiting, return_exceptions=True)
            if "route" in asked:
                scope["route"] = asked["route"]
        if head:
            await send(head[0])
            await send({"type": "http.response.body", "body": b""})


class BodyLimit:
    """Counts a body while it is read and stops at the limit: with or without ``Content-Length``, nothing is kept.

    ``mission_bytes`` is the limit where missions are sent, ``limit_bytes`` everywhere else.
    """

    def __init__(self, app: ASGIApp, limit_bytes: int, mission_bytes: int) -> None:
        self.app = app
        self.limit_bytes = limit_bytes
        self.mission_bytes = mission_bytes

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one connection."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        declared = header(scope, b"content-length") or ""
        if declared and header(scope, b"transfer-encoding"):
            # Whoever stands between may believe the other one, and take what follows for a request of its own.
            body = problems.problem_details(
                400, "a request has either Content-Length or Transfer-Encoding", kind="bad-framing"
            )
            await problems.response(body, {"connection": "close"})(scope, receive, send)
            return
        limit = self.mission_bytes if _MISSIONS.fullmatch(scope["path"]) else self.limit_bytes
        declared_bytes = int(declared) if declared.isdecimal() else 0
        if declared_bytes > limit and header(scope, b"expect"):
            # The client waits for our word before it sends anything.
            await self.refuse(limit, scope, receive, send)
            return
        read = 0

        async def limited() -> Message:
            nonlocal read
            message = await receive()
            if message["type"] == "http.request":
                read += len(message.get("body", b""))
                if read > limit:
                    await self.drain(receive, message)
                    raise BodyTooLargeError(limit)
            return message

        await self.app(scope, limited, send)

    async def refuse(self, limit: int, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer 413 without reading."""
        detail = f"the body is larger than {limit} bytes"
        entry = problems.fault("body", detail, allowed=f"at most {limit} bytes", fix="send less")
        body = problems.problem_details(413, "the body is too large", kind="too-large", errors=[entry])
        await problems.response(body, {"connection": "close"})(scope, receive, send)

    async def drain(self, receive: Receive, message: Message) -> None:
        """Read the rest and throw it away, within bounds."""
        thrown = 0
        try:
            async with asyncio.timeout(_DRAIN_S):
                while message.get("more_body") and thrown < _DRAIN_FACTOR * self.mission_bytes:
                    message = await receive()
                    thrown += len(message.get("body", b""))
        except TimeoutError:
            return
