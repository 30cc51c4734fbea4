"""Who may speak to the service in a browser: pages of its own, under a name of its own."""

from __future__ import annotations

import ipaddress
from collections.abc import Iterable
from urllib.parse import urlsplit

from starlette.middleware.trustedhost import TrustedHostMiddleware
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from api.rest import problems
from api.rest.middleware import header

_READING = {"GET", "HEAD", "OPTIONS"}


class HostGuard:
    """Refuses requests under a name that is not the service's, which defeats DNS rebinding.

    Any IP address is one of its own (no foreign name was looked up), so is localhost; further ``names`` are settings.
    """

    def __init__(self, app: ASGIApp, names: Iterable[str] = ()) -> None:
        self.app = app
        self.names = ["localhost", *names]

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one connection."""
        host = header(scope, b"host") if scope["type"] in ("http", "websocket") else ""
        if scope["type"] not in ("http", "websocket") or _is_address(host or ""):
            await self.app(scope, receive, send)
            return
        told = False

        async def known(scope: Scope, receive: Receive, _: Send) -> None:
            await self.app(scope, receive, send)

        async def refused(_: Message) -> None:
            # Starlette refuses in words of its own; ours are problem documents.
            nonlocal told
            if not told:
                told = True
                complaint = (
                    f"the service is not known as {host!r}; use its address, or list the name in SKYRELAY_ALLOWED_HOSTS"
                )
                await _refuse(complaint, scope, receive, send)

        await TrustedHostMiddleware(known, self.names, www_redirect=False)(scope, receive, refused)


def _is_address(host: str) -> bool:
    try:
        ipaddress.ip_address(urlsplit(f"//{host}").hostname or "")
    except ValueError:
        return False
    return True


async def _refuse(complaint: str, scope: Scope, receive: Receive, send: Send) -> None:
    if scope["type"] == "websocket":
        await receive()
        await send({"type": "websocket.close", "code": 1008, "reason": complaint[:120]})
        return
    body = problems.problem_details(403, complaint, kind="cross-site", title="Refused")
    await problems.response(body)(scope, receive, send)


class OriginGuard:
    """Refuses writes and sockets a foreign web page makes a browser send.

    A program sends no ``Origin``; a browser always does on a write, and it must be this service's own.
    """

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one connection."""
        if scope["type"] not in ("http", "websocket"):
            await self.app(scope, receive, send)
            return
        complaint = self.complaint(scope)
        if complaint is None:
            await self.app(scope, receive, send)
        else:
            await _refuse(complaint, scope, receive, send)

    def complaint(self, scope: Scope) -> str | None:
        """Why the connection is refused, or None."""
        host = header(scope, b"host") or ""
        if scope["type"] == "http" and scope["method"] in _READING:
            return None
        origin = header(scope, b"origin")
        if origin is not None and urlsplit(origin).netloc.lower() != host.lower():
            return f"writes from pages of {origin!r} are refused"
        if header(scope, b"sec-fetch-site") in ("cross-site", "same-site"):
            return "writes from pages of other sites are refused"
        return None
