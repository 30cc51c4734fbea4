"""Signing at its last stamps: a day of them is kept for ourselves."""

from __future__ import annotations

from test_link_signing import NOW, Clock, make, refused, sign, stamp_of, taken

from link.signing import MAX_STAMP, Verdict

DAY_UNITS = 8_640_000_000


def test_a_days_worth_of_stamps_before_the_end_of_their_range_is_kept_for_our_own() -> None:
    codec = make(Clock(NOW))
    assert refused(codec, sign(stamp=MAX_STAMP - DAY_UNITS + 1), Verdict.NO_STAMPS_LEFT)
    assert taken(codec, sign(stamp=MAX_STAMP - DAY_UNITS))
    assert stamp_of(codec.encode(_heartbeat())) == MAX_STAMP - DAY_UNITS + 1


def test_a_stream_stays_known_at_the_stamp_we_hold_ourselves() -> None:
    codec = make(Clock(NOW))
    assert taken(codec, sign(stamp=NOW))
    assert codec.signing is not None
    assert codec.signing.stamp == NOW
    # A new stream is held to our own stamp where that is ahead of the clock.
    assert taken(codec, sign(stamp=NOW + DAY_UNITS, link_id=1))
    assert refused(codec, sign(stamp=NOW + 1, link_id=2), Verdict.TOO_OLD)


def _heartbeat() -> object:
    from test_link_signing import HEARTBEAT

    return HEARTBEAT
