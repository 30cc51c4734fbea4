"""When a station is staffed.

A station's ``hours`` is text for people. Where it reads as daily spans in UTC, ``HH:MM-HH:MM`` with several
separated by commas (a span may run over midnight; ``24/7`` is always), programs can tell whether somebody is there.
"""

from __future__ import annotations

import re
from datetime import UTC, datetime

_SPAN = re.compile(r"([01]\d|2[0-4]):([0-5]\d)\s*[-–]\s*([01]\d|2[0-4]):([0-5]\d)")
_DAY = 24 * 60


def staffed(hours: str | None, moment: datetime) -> bool | None:
    """Whether the station is staffed at ``moment`` (with a time zone); None where the text does not tell."""
    if hours is None:
        return None
    text = hours.strip().removesuffix("UTC").removesuffix("Z").strip()
    if text == "24/7":
        return True
    spans = [_SPAN.fullmatch(part.strip()) for part in text.split(",")]
    at = moment.astimezone(UTC)
    minute = at.hour * 60 + at.minute + at.second / 60.0
    known = False
    for span in spans:
        if span is None:
            return None
        begin = int(span[1]) * 60 + int(span[2])
        end = int(span[3]) * 60 + int(span[4])
        if begin > _DAY or end > _DAY:
            return None
        inside = begin <= minute < end if begin < end else minute >= begin or minute < end
        known = known or inside
    return known
