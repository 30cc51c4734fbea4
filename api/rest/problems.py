"""Every error the service answers with: RFC 9457 problem details, whatever went wrong.

ApiError
├── NotFoundError           404
├── ConflictError           409   not possible in the present state; may carry reason, place, gap_m, fix
├── UnsupportedMediaError   415   the body is not JSON, or does not say so
├── UnprocessableError      422   the request makes no sense: ``errors`` says where, what, allowed, fix
├── ForbiddenError          403   a write from another site
├── UnavailableError        503   a part this needs is not there
└── BodyTooLargeError       413   (an HTTPException, so that nothing on its way re-labels it)

`install` makes an application answer all of these, its own 404 and 405, and validation errors in one form:
``{"type", "title", "status", "detail", "request_id", "errors": [{"where", "what", "value", "allowed", "fix"}]}``.
"""

from __future__ import annotations

import http
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, ClassVar

import structlog
from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from starlette.exceptions import HTTPException
from starlette.responses import JSONResponse, Response
from starlette.routing import BaseRoute, Match

PROBLEM_TYPE = "application/problem+json"
_URN = "urn:skyrelay:problem:"
_VALUE_LIMIT = 200


class ApiError(Exception):
    """Base of what a route raises on purpose; becomes a problem document."""

    status: ClassVar[int] = 500
    kind: ClassVar[str] = "fault"
    title: ClassVar[str] = "A fault of the service"

    def __init__(
        self,
        detail: str,
        *,
        errors: Iterable[Mapping[str, Any]] = (),
        kind: str | None = None,
        title: str | None = None,
        **more: Any,
    ) -> None:
        super().__init__(detail)
        self.detail = detail
        self.errors = [fault(**e) for e in errors]
        self.problem_kind = kind or self.kind
        self.problem_title = title or self.title
        self.more = more


class NotFoundError(ApiError):
    """Nothing of that id."""

    status = 404
    kind = "not-found"
    title = "Not found"


class ConflictError(ApiError):
    """Cannot be done in the present state."""

    status = 409
    kind = "conflict"
    title = "Not possible in the present state"


class UnsupportedMediaError(ApiError):
    """The body is not JSON, or does not say so."""

    status = 415
    kind = "unsupported-media"
    title = "The body is not JSON"


class UnprocessableError(ApiError):
    """The request is understood and makes no sense."""

    status = 422
    kind = "bad-input"
    title = "Bad input"


class ForbiddenError(ApiError):
    """A write that did not come from the service's own page or a program."""

    status = 403
    kind = "cross-site"
    title = "Refused"


class UnavailableError(ApiError):
    """Something this needs is not there."""

    status = 503
    kind = "unavailable"
    title = "Not available"


class BodyTooLargeError(HTTPException):
    """The body passed the limit while it was read."""

    def __init__(self, limit_bytes: int) -> None:
        super().__init__(413, f"the body is larger than {limit_bytes} bytes")
        self.limit_bytes = limit_bytes


def fault(
    where: str,
    what: str,
    value: Any = None,
    allowed: str | None = None,
    fix: str | None = None,
) -> dict[str, Any]:
    """One entry of ``errors``; the value shortened and made JSON-safe, since it came from outside."""
    entry: dict[str, Any] = {"where": _whole(where), "what": _whole(what)}
    if value is not None:
        entry["value"] = _safe(value)
    if allowed:
        entry["allowed"] = allowed
    if fix:
        entry["fix"] = fix
    return entry


def _safe(value: Any) -> Any:
    if isinstance(value, bool | int) and abs(value) < 2**53:
        return value
    if isinstance(value, float) and math.isfinite(value):
        return value
    text = value if isinstance(value, str) else repr(value)
    text = _whole(text)
    return text if len(text) <= _VALUE_LIMIT else text[: _VALUE_LIMIT - 3] + "..."


def _whole(text: str) -> str:
    """The text with half characters, which no answer can hold, replaced."""
    return text.encode("utf-8", "replace").decode("utf-8")


def domain_faults(faults: Iterable[Any]) -> list[dict[str, Any]]:
    """``InputFault(where, what, value, allowed, fix)`` of ``gcs.errors`` as arguments of `fault`."""
    return [{"where": f.where, "what": f.what, "value": f.value, "allowed": f.allowed, "fix": f.fix} for f in faults]


def problem_details(
    status: int,
    detail: str,
    *,
    kind: str,
    title: str | None = None,
    errors: Iterable[Mapping[str, Any]] = (),
    more: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Problem details (RFC 9457) as data."""
    body: dict[str, Any] = {
        "type": _URN + kind,
        "title": title or http.HTTPStatus(status).phrase,
        "status": status,
        "detail": _whole(detail),
    }
    request_id = structlog.contextvars.get_contextvars().get("request_id")
    if request_id is not None:
        body["request_id"] = request_id
    body["errors"] = list(errors)
    return body | dict(more or {})


def response(body: Mapping[str, Any], headers: Mapping[str, str] | None = None) -> Response:
    """Problem details as an answer."""
    return JSONResponse(body, status_code=body["status"], headers=dict(headers or {}), media_type=PROBLEM_TYPE)


def fault_details() -> dict[str, Any]:
    """What the outside is told of a fault of ours: nothing but the id that finds it in the log."""
    return problem_details(
        500, "a fault of the service; its log has more under this request id", kind="fault", title=ApiError.title
    )


_STATUS_KINDS = {
    404: ("not-found", "there is nothing at this address"),
    405: ("method-not-allowed", "this address does not take that method"),
    413: ("too-large", "the body is too large"),
}


def install(app: FastAPI, routes: Sequence[BaseRoute]) -> None:
    """Make ``app``, whose routes these are, answer every error as a problem document."""

    async def on_api_error(_request: Request, error: Exception) -> Response:
        assert isinstance(error, ApiError)
        return response(
            problem_details(
                error.status,
                error.detail,
                kind=error.problem_kind,
                title=error.problem_title,
                errors=error.errors,
                more=error.more,
            )
        )

    async def on_http(request: Request, error: Exception) -> Response:
        assert isinstance(error, HTTPException)
        if error.status_code == 400:
            # The framework's word for a body it cannot decode; malformed is 422 here, whatever is malformed.
            entry = fault("body", "cannot be read", allowed="JSON in UTF-8", fix="correct the text")
            return response(
                problem_details(422, "body: cannot be read", kind="bad-input", title="Bad input", errors=[entry])
            )
        kind, said = _STATUS_KINDS.get(error.status_code, (f"http-{error.status_code}", str(error.detail)))
        entries = []
        detail = said
        if isinstance(error, BodyTooLargeError):
            entries = [fault("body", error.detail, allowed=f"at most {error.limit_bytes} bytes", fix="send less")]
        elif error.status_code in (404, 405):
            detail = f"{said}: {request.method} {request.url.path}"
        headers = dict(error.headers or {})
        if error.status_code == 405:
            headers["Allow"] = ", ".join(_allowed_methods(request, routes))
        return response(problem_details(error.status_code, detail, kind=kind, errors=entries), headers)

    async def on_invalid(_request: Request, error: Exception) -> Response:
        assert isinstance(error, RequestValidationError)
        entries = [_of_pydantic(e) for e in error.errors()]
        summary = "; ".join(f"{e['where']}: {e['what']}" for e in entries[:3])
        return response(problem_details(422, summary, kind="bad-input", title="Bad input", errors=entries))

    app.add_exception_handler(ApiError, on_api_error)
    app.add_exception_handler(HTTPException, on_http)
    app.add_exception_handler(RequestValidationError, on_invalid)


def _allowed_methods(request: Request, routes: Sequence[BaseRoute]) -> list[str]:
    """What the address of a request takes, over all its routes; HEAD goes wherever GET does."""
    found: set[str] = set()
    for route in routes:
        if route.matches(request.scope)[0] is not Match.NONE:
            found |= set(getattr(route, "methods", None) or ())
    return sorted(found | {"HEAD"} if "GET" in found else found)


def _of_pydantic(error: Mapping[str, Any]) -> dict[str, Any]:
    place = ".".join(str(part) for part in error.get("loc", ()))
    context = error.get("ctx") or {}
    allowed = context.get("expected") or context.get("pattern")
    if allowed is None:
        bounds = {"ge": "at least", "gt": "more than", "le": "at most", "lt": "less than"}
        allowed = ", ".join(f"{word} {context[name]}" for name, word in bounds.items() if name in context) or None
    value = None if error["type"] in ("missing", "json_invalid") else error.get("input")
    return fault(place, str(error["msg"]), value, allowed=None if allowed is None else str(allowed))
