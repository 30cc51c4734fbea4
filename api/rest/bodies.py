"""Bodies at the door, the same for every route: JSON under its own name, each field once, text that is text.

`StrictRoute` checks before FastAPI reads; a route that takes the bytes themselves (missions have a reader of their own)
has its media type checked alone.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Coroutine, Iterator
from email.message import Message
from typing import Any

from fastapi import Request
from fastapi.routing import APIRoute
from starlette.responses import Response

from api.rest.problems import UnprocessableError, UnsupportedMediaError
from gcs.document_reader import parse_json
from gcs.errors import MissionError

_WITH_BODY = {"POST", "PUT", "PATCH"}
_Handler = Callable[[Request], Coroutine[Any, Any, Response]]


class StrictRoute(APIRoute):
    """A route whose JSON body is read strictly."""

    def get_route_handler(self) -> _Handler:
        """FastAPI's handler behind the checks."""
        handler = super().get_route_handler()
        reads_json = self.body_field is not None

        async def checked(request: Request) -> Response:
            if request.method in _WITH_BODY:
                body = await request.body()
                if body:
                    check_media_type(request.headers.get("content-type"))
                    if reads_json:
                        # Where Starlette keeps it, so that it is read once.
                        request._json = strict_json(body)
            return await handler(request)

        return checked


def check_media_type(given: str | None) -> None:
    """Raises `UnsupportedMediaError` for anything but JSON in UTF-8; nothing said counts as that."""
    if not given:
        return
    message = Message()
    message["content-type"] = given
    charset = message.get_content_charset("utf-8")
    if message.get_content_type() != "application/json" or charset not in ("utf-8", "utf8", "us-ascii"):
        raise UnsupportedMediaError(
            "the body must be JSON, and its Content-Type must say so",
            errors=[
                {
                    "where": "header.Content-Type",
                    "what": "is not JSON in UTF-8",
                    "value": given,
                    "allowed": "application/json",
                    "fix": "send it as application/json",
                }
            ],
        )


def strict_json(body: bytes) -> Any:
    """The document of a body. Raises `UnprocessableError` with the place of what is wrong."""
    try:
        document = parse_json(body, max_bytes=len(body))
    except MissionError as error:
        entries = [
            {
                "where": "body" if fault.where == "mission" else f"body.{fault.where}",
                "what": fault.what,
                "value": fault.value,
                "allowed": "JSON as documented" if fault.where == "mission" else fault.allowed,
                "fix": fault.fix,
            }
            for fault in error.problems
        ]
        raise UnprocessableError(f"{entries[0]['where']}: {entries[0]['what']}", errors=entries) from None
    for where in _no_text(document, "body"):
        raise UnprocessableError(
            f"{where}: is no text",
            errors=[
                {
                    "where": where,
                    "what": "holds half a character or a NUL",
                    "allowed": "whole characters, without U+0000",
                    "fix": "remove it",
                }
            ],
        )
    return document


def _no_text(value: Any, where: str) -> Iterator[str]:
    """Places of texts, keys included, that no database and no UTF-8 can hold."""
    todo = [(value, where)]
    while todo:
        value, where = todo.pop()
        if isinstance(value, str):
            if not _storable(value):
                yield where
        elif isinstance(value, list):
            todo += [(item, f"{where}[{k}]") for k, item in enumerate(value)]
        elif isinstance(value, dict):
            for key, item in value.items():
                if not _storable(key):
                    yield f"{where}.{json.dumps(key)[1:-1][:64]}"
                todo.append((item, f"{where}.{key[:64]}"))


def _storable(text: str) -> bool:
    return "\0" not in text and not any("\ud800" <= character <= "\udfff" for character in text)
