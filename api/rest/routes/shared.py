"""What routes share: bodies read by hand, ids, cursors, the domain's errors as problems."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Annotated, Any

from fastapi import Depends, Header, Path, Query, Request

from api.rest.problems import (
    ApiError,
    ConflictError,
    NotFoundError,
    UnavailableError,
    UnprocessableError,
    domain_faults,
)
from api.service import ReplanError, ReplanFailedError, ReplanInfeasibleError, StillStoppingError
from gcs import errors as gcs_errors
from gcs.flight import TransitionError
from gcs.store import Idempotency
from link.errors import FlightRequestError, SupervisorError

MAX_PAGE = 200
# As this service gives them out.
PLAIN_ID = r"^[0-9A-Za-z_-]+$"


async def _body(request: Request) -> bytes:
    return await request.body()


RawBody = Annotated[bytes, Depends(_body)]
IdempotencyKey = Annotated[
    str | None,
    Header(
        alias="Idempotency-Key",
        min_length=1,
        max_length=255,
        pattern=r"^[\x21-\x7e]+$",
        description="A name for this request: repeating it with the same body gives the same answer and makes "
        "nothing twice; with another body it is refused.",
    ),
]
MissionId = Annotated[str, Path(max_length=64, pattern=PLAIN_ID, examples=["0b6f3c1e8e0f4c0d9b1f2a3c4d5e6f70"])]
Version = Annotated[int | None, Query(ge=1, le=2**31 - 1, description="Version of the mission; default the latest.")]
Limit = Annotated[int, Query(ge=1, le=MAX_PAGE, description="Most items on this page.")]
Cursor = Annotated[
    str | None, Query(max_length=128, description="`next` of the page before; absent for the first page.")
]


def idempotency(scope: str, key: str | None, body: bytes) -> Idempotency | None:
    """What the store needs to recognise a repeated request; None without a key."""
    return None if key is None else Idempotency(scope, key, hashlib.sha256(body).hexdigest())


def cursor_number(cursor: str | None) -> int | None:
    """The row number a cursor of missions or flights stands for. Raises `UnprocessableError`."""
    if cursor is None:
        return None
    if not cursor.isascii() or not cursor.isdecimal() or len(cursor) > 18:
        raise UnprocessableError(
            "the cursor is not one of this service's",
            errors=[
                {
                    "where": "query.cursor",
                    "what": "is not a cursor",
                    "value": cursor,
                    "allowed": "`next` of the page before",
                    "fix": "leave it out for the first page",
                }
            ],
        )
    return int(cursor)


def api_error_of(error: Exception) -> ApiError | None:
    """A domain error as the problem it means to the outside; None for one nobody expects."""
    match error:
        case gcs_errors.MissionError():
            faults = domain_faults(error.problems)
            first = f"{faults[0]['where']}: {faults[0]['what']}" if faults else str(error)
            more = f" (and {len(faults) - 1} more)" if len(faults) > 1 else ""
            return UnprocessableError(first + more, errors=faults)
        case gcs_errors.ExportError() | gcs_errors.PlanError():
            return UnprocessableError(str(error))
        case gcs_errors.NotFoundError():
            return NotFoundError(str(error))
        case gcs_errors.QueueFullError():
            return UnavailableError(str(error), kind="queue-full", title="Too many missions wait", retry_after_s=10)
        case gcs_errors.ConflictError():
            return ConflictError(str(error))
        case ReplanInfeasibleError():
            found = error.finding.to_document()
            told: dict[str, Any] = {
                k: found[k] for k in ("reason", "stations", "where", "gap_m", "fix") if found.get(k) is not None
            }
            return ConflictError(str(error), kind="infeasible", title="There is no such flight from here", **told)
        case ReplanFailedError():
            return ConflictError(str(error), kind="planning-failed")
        case StillStoppingError():
            return ConflictError(str(error), kind="not-now")
        case ReplanError():
            return ConflictError(str(error))
        case TransitionError():
            return ConflictError(str(error), kind="not-now")
        case FlightRequestError():
            return UnprocessableError("the flight cannot start as asked", errors=domain_faults(error.problems))
        case SupervisorError():
            return UnavailableError(str(error), kind="streamer", title="The streamer cannot be reached")
        case gcs_errors.StoreUnavailable():
            return UnavailableError(
                str(error), kind="store", title="The store cannot be used just now", retry_after_s=1
            )
    return None


@contextmanager
def domain_errors() -> Iterator[None]:
    """Errors of the domain inside become problems; others pass."""
    try:
        yield
    except ApiError:
        raise
    except Exception as error:
        problem = api_error_of(error)
        if problem is None:
            raise
        raise problem from error


def conflict(detail: str) -> ConflictError:
    """Not possible in the present state."""
    return ConflictError(detail)


def one_of(where: str, value: str, allowed: tuple[str, ...]) -> str:
    """``value`` if it is allowed. Raises `UnprocessableError` that lists what is."""
    if value not in allowed:
        raise UnprocessableError(
            f"{where}: there is no {value!r}",
            errors=[
                {
                    "where": f"query.{where}",
                    "what": "is not one of the choices",
                    "value": value,
                    "allowed": ", ".join(allowed),
                    "fix": "choose one of these",
                }
            ],
        )
    return value
