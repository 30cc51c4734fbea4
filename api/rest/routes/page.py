"""The page: static files of this package, no build step, nothing from elsewhere.

``/assets`` serves ``api/web`` by Starlette's `StaticFiles` (entity tags, no path out of the folder), compressed where
the browser takes that: the page's third-party parts are large.
"""

from __future__ import annotations

import mimetypes
from pathlib import Path
from typing import Final

from fastapi import APIRouter, FastAPI
from starlette.middleware.gzip import GZipMiddleware
from starlette.responses import FileResponse, Response
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp, Message, Receive, Scope, Send

router = APIRouter(include_in_schema=False)

_FOLDER: Final = Path(__file__).parents[2] / "web"
_HEADERS: Final = {
    "Content-Security-Policy": "default-src 'self'; img-src 'self' data:; frame-ancestors 'none'; base-uri 'none'; "
    "form-action 'self'; object-src 'none'",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "Cache-Control": "no-cache",
}


class _WithHeaders:
    """Adds the page's headers to every answer."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one connection."""

        async def headed(message: Message) -> None:
            if message["type"] == "http.response.start":
                added = [(name.lower().encode(), value.encode()) for name, value in _HEADERS.items()]
                message["headers"] = [*message["headers"], *added]
            await send(message)

        await self.app(scope, receive, headed)


for suffix in (".js", ".mjs"):  # the machine's own table may say otherwise, and browsers refuse modules then
    mimetypes.add_type("text/javascript", suffix)


def mount(app: FastAPI) -> None:
    """Serve the page's files below ``/assets``."""
    app.mount("/assets", _WithHeaders(GZipMiddleware(StaticFiles(directory=_FOLDER), minimum_size=1000)), name="assets")


def _page(name: str) -> Response:
    return FileResponse(_FOLDER / name, headers=_HEADERS)


@router.get("/")
def index() -> Response:
    """The page."""
    return _page("index.html")


@router.get("/docs")
def reference() -> Response:
    """The API reference, drawn from the OpenAPI document."""
    return _page("reference.html")


@router.get("/favicon.ico")
def icon() -> Response:
    """What browsers ask for by themselves."""
    return _page("icon.svg")
