"""Instants as text: the same instant in every precision, whatever zone it is given in."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta, timezone

import pytest

from gcs.timestamps import Precision, utc_for_people, utc_now_text, utc_text

# 09:59:59.999987 in UTC, given in a zone 5.5 hours ahead of it.
MOMENT = datetime(2026, 11, 22, 15, 29, 59, 999_987, tzinfo=timezone(timedelta(hours=5.5)))


@pytest.mark.parametrize(
    ("precision", "text"),
    [
        ("seconds", "2026-11-22T09:59:59Z"),
        ("milliseconds", "2026-11-22T09:59:59.999Z"),
        ("microseconds", "2026-11-22T09:59:59.999987Z"),
    ],
)
def test_digits_beyond_the_precision_are_cut_off(precision: Precision, text: str) -> None:
    assert utc_text(MOMENT, precision) == text


def test_whole_seconds_are_written_with_their_zeros() -> None:
    whole = MOMENT.replace(microsecond=0)
    assert utc_text(whole, "milliseconds") == "2026-11-22T09:59:59.000Z"
    assert utc_text(whole, "microseconds") == "2026-11-22T09:59:59.000000Z"


def test_for_people_and_now() -> None:
    assert utc_for_people(MOMENT) == "2026-11-22 09:59:59 UTC"
    said = datetime.fromisoformat(utc_now_text())
    assert abs(said - datetime.now(UTC)) < timedelta(seconds=10)
