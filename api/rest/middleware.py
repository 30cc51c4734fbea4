"""What every request passes: an id and a log line, the guard against other sites, the limit on bodies.

Plain ASGI, so that streamed answers stay streamed. Order from outside in: `RequestLog`, `OriginGuard`, `BodyLimit`.
"""

from __future__ import annotations

import asyncio
import ipaddress
import re
import time
import uuid
from collections.abc import Callable, Iterable
from urllib.parse import urlsplit

import structlog
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from api.rest import problems
from api.rest.problems import BodyTooLargeError

_REQUEST_ID = re.compile(r"[A-Za-z0-9._-]{1,64}")
_READING = {"GET", "HEAD", "OPTIONS"}
# A body past the limit is read to its end (up to these) and thrown away, so that the client hears the answer
# instead of a reset connection.
_DRAIN_FACTOR = 40
_DRAIN_S = 10.0

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


class OriginGuard:
    """Refuses writes and sockets a foreign web page makes a browser send, and names that only look like ours.

    A program sends no ``Origin``; a browser always does on a write, and it must be this service's own. ``Host`` must
    be an address or a known name, which defeats DNS rebinding: a foreign name pointed at the loopback address.
    """

    def __init__(self, app: ASGIApp, hosts: Iterable[str] = ()) -> None:
        self.app = app
        self.hosts = {"localhost", *(h.lower() for h in hosts)}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one connection."""
        if scope["type"] not in ("http", "websocket"):
            await self.app(scope, receive, send)
            return
        complaint = self.complaint(scope)
        if complaint is None:
            await self.app(scope, receive, send)
        elif scope["type"] == "websocket":
            await receive()
            await send({"type": "websocket.close", "code": 1008, "reason": complaint})
        else:
            body = problems.problem_details(403, complaint, kind="cross-site", title="Refused")
            await problems.response(body)(scope, receive, send)

    def complaint(self, scope: Scope) -> str | None:
        """Why the connection is refused, or None."""
        host = header(scope, b"host") or ""
        if not self.known(host):
            return f"the service is not known as {host!r}; use its address, or list the name in the allowed hosts"
        if scope["type"] == "http" and scope["method"] in _READING:
            return None
        origin = header(scope, b"origin")
        if origin is not None and urlsplit(origin).netloc.lower() != host.lower():
            return f"writes from pages of {origin!r} are refused"
        if header(scope, b"sec-fetch-site") in ("cross-site", "same-site"):
            return "writes from pages of other sites are refused"
        return None

    def known(self, host: str) -> bool:
        """Whether ``Host`` names an address or a name of ours."""
        try:
            name = urlsplit(f"//{host}").hostname or ""
        except ValueError:
            return False
        if name in self.hosts:
            return True
        try:
            ipaddress.ip_address(name)
        except ValueError:
            return False
        return True


class BodyLimit:
    """Counts a body while it is read and stops at the limit: with or without ``Content-Length``, nothing is kept."""

    def __init__(self, app: ASGIApp, limit_bytes: int) -> None:
        self.app = app
        self.limit_bytes = limit_bytes

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one connection."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        declared = header(scope, b"content-length") or ""
        declared_bytes = int(declared) if declared.isdecimal() else 0
        if declared_bytes > self.limit_bytes and header(scope, b"expect"):
            # The client waits for our word before it sends anything.
            await self.refuse(scope, receive, send)
            return
        read = 0

        async def limited() -> Message:
            nonlocal read
            message = await receive()
            if message["type"] == "http.request":
                read += len(message.get("body", b""))
                if read > self.limit_bytes:
                    await self.drain(receive, message)
                    raise BodyTooLargeError(self.limit_bytes)
            return message

        await self.app(scope, limited, send)

    async def refuse(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer 413 without reading."""
        detail = f"the body is larger than {self.limit_bytes} bytes"
        entry = problems.fault("body", detail, allowed=f"at most {self.limit_bytes} bytes", fix="send less")
        body = problems.problem_details(413, "the body is too large", kind="too-large", errors=[entry])
        await problems.response(body, {"connection": "close"})(scope, receive, send)

    async def drain(self, receive: Receive, message: Message) -> None:
        """Read the rest and throw it away, within bounds."""
        thrown = 0
        try:
            async with asyncio.timeout(_DRAIN_S):
                while message.get("more_body") and thrown < _DRAIN_FACTOR * self.limit_bytes:
                    message = await receive()
                    thrown += len(message.get("body", b""))
        except TimeoutError:
            return
