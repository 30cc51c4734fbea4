"""The first page: static files of this package, no build step, nothing from elsewhere."""

from __future__ import annotations

from importlib import resources
from typing import Final

from fastapi import APIRouter
from starlette.responses import Response

from api.rest.problems import NotFoundError

router = APIRouter(include_in_schema=False)

_TYPES: Final = {
    ".html": "text/html; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".svg": "image/svg+xml",
}
_HEADERS: Final = {
    "Content-Security-Policy": "default-src 'self'; style-src 'self' 'unsafe-inline'; frame-ancestors 'none'; "
    "base-uri 'none'; form-action 'self'",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "Cache-Control": "no-cache",
}


def _file(name: str) -> Response:
    suffix = name[name.rfind(".") :]
    # Names are compared with what the package holds, so that no path can lead out of it.
    held = {entry.name: entry for entry in resources.files("api").joinpath("web").iterdir()}
    if suffix not in _TYPES or name not in held:
        raise NotFoundError(f"the page has no file {name}")
    return Response(held[name].read_bytes(), media_type=_TYPES[suffix], headers=_HEADERS)


@router.get("/")
def index() -> Response:
    """The page."""
    return _file("index.html")


@router.get("/docs")
def reference() -> Response:
    """The API reference, drawn from the OpenAPI document."""
    return _file("reference.html")


@router.get("/favicon.ico")
def icon() -> Response:
    """What browsers ask for by themselves."""
    return _file("icon.svg")


@router.get("/assets/{name}")
def asset(name: str) -> Response:
    """A style sheet, script or image of the page."""
    return _file(name)
