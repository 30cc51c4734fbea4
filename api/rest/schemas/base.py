"""What bodies have in common, and RFC 9457 problem details."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

INFEASIBLE_EXAMPLE: dict[str, Any] = {
    "type": "urn:skyrelay:problem:infeasible",
    "title": "No flight can fulfil this mission",
    "status": 409,
    "detail": "There is a gap of 2113.4 m between terschelling and ballum.",
    "request_id": "5f0c6f7a3f1b4a0c9f5c0a3b8d6e2f11",
    "errors": [],
    "reason": "broken_chain",
    "place": {"lat_deg": 53.41, "lon_deg": 5.44, "alt_amsl_m": 90.0},
    "gap_m": 2113.4,
    "stations": ["terschelling", "ballum"],
    "fix": {"action": "raise_range", "station": "ballum", "by_m": 2113.5},
    "fix_text": "Raise the range of ballum by 2113.5 m.",
}
BAD_INPUT_EXAMPLE: dict[str, Any] = {
    "type": "urn:skyrelay:problem:bad-input",
    "title": "Bad input",
    "status": 422,
    "detail": "the mission has a fault",
    "request_id": "5f0c6f7a3f1b4a0c9f5c0a3b8d6e2f11",
    "errors": [
        {
            "where": "stations[0].range_m",
            "what": "must not be negative",
            "value": -5.0,
            "allowed": "more than 0 up to 500000 m",
        }
    ],
}


ENTRY_ID = r"^[^\W_][\w .:+#()'&-]{0,63}$"
# No control, direction or zero-width character: a name must look like what it is, in logs and on the radio.
_UNSEEN = r"\x00-\x1f\x7f-\x9f\xad\u200b-\u200f\u2028-\u202e\u2060-\u206f\ufeff"
TEXT = f"^[^{_UNSEEN}]*$"
# The same, not empty, without blanks at its ends.
NAME = rf"^[^\s{_UNSEEN}]([^{_UNSEEN}]*[^\s{_UNSEEN}])?$"


def _whole(value: Any) -> Any:
    return int(value) if isinstance(value, float) and value.is_integer() else value


# JSON has one kind of number: 3.0 is a whole one.
Whole = Annotated[int, BeforeValidator(_whole)]
Text = Annotated[str, Field(pattern=TEXT)]


class Open(BaseModel):
    """A document that may grow further fields."""

    model_config = ConfigDict(extra="allow")


class Closed(BaseModel):
    """A body in which an unknown field is a mistake worth telling, and so is a value of another type."""

    model_config = ConfigDict(extra="forbid", strict=True)


class ProblemEntry(Open):
    """One thing wrong."""

    where: str = Field(description="Path of the field, such as stations[3].range_m.")
    what: str = Field(description="What is wrong.")
    value: Any = Field(None, description="What stands there.")
    allowed: str | None = Field(None, description="What may stand there.")
    fix: str | None = Field(None, description="What to do.")


class ProblemDetails(Open):
    """Problem details (RFC 9457)."""

    type: str = Field(description="A name for this kind of problem.")
    title: str
    status: int
    detail: str
    request_id: str | None = Field(None, description="Finds the request in the service's log.")
    errors: list[ProblemEntry] = Field(default_factory=list)


class InfeasibleDetails(ProblemDetails):
    """Why no flight can fulfil the mission."""

    reason: str | None = Field(None, description="A word for programs: broken_chain, start_uncovered, ...")
    place: dict[str, float] | None = Field(None, description="Where.")
    gap_m: float | None = Field(None, description="How much range is missing.")
    stations: list[str] | None = None
    fix: dict[str, Any] | None = Field(None, description="The smallest single remedy, as data.")
    fix_text: str | None = Field(None, description="The same in words.")
    causes: list[dict[str, Any]] | None = Field(
        None, description="Where several things stand in the way: all of them, in flight order, each with its own fix."
    )


class Health(Closed):
    """How the service is."""

    status: Literal["ok", "ready"]
    version: str
    checks: dict[str, str]
