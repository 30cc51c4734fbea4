"""An instant as text: RFC 3339 in UTC with a ``Z``, in the precision its reader asks for.

    seconds        2026-11-22T09:00:00Z          a plan's ``created_utc``
    milliseconds   2026-11-22T09:00:00.250Z      events of a flight, times of a handover schedule
    microseconds   2026-11-22T09:00:00.250000Z   the store: sorts as text as it does as time
    for people     2026-11-22 09:00:00 UTC       what a program says in a sentence

Digits beyond the precision are cut off, not rounded.
"""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Literal

Precision = Literal["seconds", "milliseconds", "microseconds"]


def utc_text(moment: datetime, precision: Precision = "seconds") -> str:
    """``moment``, which has a time zone, in RFC 3339."""
    return moment.astimezone(UTC).isoformat(timespec=precision).replace("+00:00", "Z")


def utc_now_text(precision: Precision = "milliseconds") -> str:
    """This moment by the machine's clock."""
    return utc_text(datetime.now(UTC), precision)


def utc_for_people(moment: datetime) -> str:
    """``moment``, to the second, as a sentence holds it."""
    return moment.astimezone(UTC).strftime("%Y-%m-%d %H:%M:%S UTC")
