"""Message signing, rule by rule; the stock implementation's measured faults among them.

The vehicle is played by a second codec, by pymavlink's own signing (independent), or by frames signed here by hand.
The numbered rules first, then the last stamps of their range, and the file stamps are kept in.
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import multiprocessing
import os
import pickle
import random
import subprocess
import sys
import traceback
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega, common

from link.dialect import mavlink
from link.errors import SigningError, SigningKeyError
from link.wire import memory_file
from link.wire.codec import StationCodec
from link.wire.signing import MAX_STAMP, NEW_STREAM_BEHIND_UNITS, UNITS_PER_S, Signing, SigningKey, Verdict, WallStamp
from link.wire.signing_timestamps import SigningStore
from tests.support.flights.processes import open_files
from tests.support.link.recordings import load
from tests.support.link.signing_kit import (
    HEARTBEAT,
    KEY,
    NOW,
    SECRET,
    Clock,
    make,
    refused,
    sign,
    stamp_of,
    taken,
    vehicle,
)

WRONG = bytes(range(2, 34))
RADIO_STATUS = mavlink.MAVLink_radio_status_message(180, 170, 90, 40, 40, 0, 0)


@pytest.fixture
def clock() -> Clock:
    return Clock()


# ---------------------------------------------------------------- what is sent


def test_01_signature_by_hand(clock: Clock) -> None:
    """13 bytes: link id, 48-bit stamp, 48 bits of SHA-256 of key and frame; the flag is inside the checksum."""
    frame = make(clock).encode(HEARTBEAT)
    assert len(frame) == 10 + 9 + 2 + 13
    assert frame[2] == 0x01
    assert frame[-13] == 241
    assert stamp_of(frame) == NOW
    assert frame[-6:] == hashlib.sha256(SECRET + frame[:-6]).digest()[:6]


def test_02_stamps_rise_by_one_when_the_clock_does_not_move(clock: Clock) -> None:
    codec = make(clock)
    assert [stamp_of(codec.encode(HEARTBEAT)) - NOW for _ in range(4)] == [0, 1, 2, 3]


def test_03_after_an_idle_hour_the_stamp_is_the_clocks(clock: Clock) -> None:
    """Stock moves it by one unit: an hour-old stamp, refused as a new stream by whoever was restarted."""
    codec = make(clock)
    codec.encode(HEARTBEAT)
    clock.advance(3600)
    assert stamp_of(codec.encode(HEARTBEAT)) == NOW + 3600 * UNITS_PER_S


def test_04_a_clock_that_jumps_back_does_not_take_the_stamp_with_it(clock: Clock) -> None:
    codec = make(clock)
    first = stamp_of(codec.encode(HEARTBEAT))
    clock.advance(-86_400)
    assert stamp_of(codec.encode(HEARTBEAT)) == first + 1


def test_05_the_wall_clock_is_read_once() -> None:
    """A jump of the wall clock by a day moves nothing: the monotonic clock carries the stamp on."""
    wall, monotonic = [1_795_338_000.0], [5000.0]
    now = WallStamp(lambda: wall[0], lambda: monotonic[0])
    assert now() == pytest.approx(NOW, abs=1)
    wall[0] += 86_400
    monotonic[0] += 10
    assert now() == pytest.approx(NOW + 10 * UNITS_PER_S, abs=1)


def test_05b_stamps_count_tens_of_microseconds_since_2015() -> None:
    wall = datetime(2015, 1, 1, 0, 0, 1, tzinfo=UTC).timestamp()
    assert WallStamp(lambda: wall, lambda: 7.0)() == 100_000
    assert MAX_STAMP == 281_474_976_710_655


def test_06_a_clock_before_2015_is_zero_not_negative() -> None:
    assert WallStamp(lambda: 0.0, lambda: 0.0)() == 0


def test_07_each_station_signs_with_its_own_link_id(clock: Clock) -> None:
    assert [make(clock, system=s).encode(HEARTBEAT)[-13] for s in (241, 242, 243)] == [241, 242, 243]


def test_08_setup_signing_is_never_sent(clock: Clock) -> None:
    with pytest.raises(SigningError, match="key in the clear"):
        make(clock).encode(mavlink.MAVLink_setup_signing_message(1, 1, SECRET, NOW))


def test_09_the_stock_receiver_takes_what_we_sign(clock: Clock) -> None:
    stock = common.MAVLink(None)
    stock.signing.secret_key = SECRET
    codec = make(clock)
    for _ in range(3):
        (got,) = stock.parse_buffer(codec.encode(HEARTBEAT))
        assert got.get_signed()


def test_10_we_take_what_the_stock_sender_signs(clock: Clock) -> None:
    stock = common.MAVLink(None, srcSystem=1, srcComponent=1)
    stock.signing.secret_key, stock.signing.sign_outgoing = SECRET, True
    stock.signing.timestamp, stock.signing.link_id = NOW, 3
    codec = make(clock)
    frame = common.MAVLink_heartbeat_message(2, 3, 81, 4, 4, 3).pack(stock)
    (got,) = codec.decode(frame)
    assert (got.get_signed(), got.get_link_id()) == (True, 3)


# ---------------------------------------------------------------- what is refused


def test_11_good_frames_are_taken_and_marked_as_signed(clock: Clock) -> None:
    codec = make(clock)
    (got,) = codec.decode(sign())
    assert got.get_signed()
    assert codec.stats.refused == {}


def test_12_a_wrong_key(clock: Clock) -> None:
    assert refused(make(clock), sign(secret=WRONG), Verdict.WRONG_SIGNATURE)


@pytest.mark.parametrize("position", [-1, -6, -7, -12, -13])
def test_13_a_changed_bit_in_signature_stamp_or_link_id(clock: Clock, position: int) -> None:
    frame = bytearray(sign())
    frame[position] ^= 1
    assert refused(make(clock), bytes(frame), Verdict.WRONG_SIGNATURE)


def test_14_a_changed_payload_with_its_checksum_made_good(clock: Clock) -> None:
    frame = bytearray(sign())
    frame[10] ^= 1
    crc = mavlink.x25crc(bytes(frame[1:-15]) + bytes([50])).crc
    frame[-15:-13] = crc.to_bytes(2, "little")
    assert refused(make(clock), bytes(frame), Verdict.WRONG_SIGNATURE)


def test_15_unsigned(clock: Clock) -> None:
    assert refused(make(clock), StationCodec(1, 1).encode(HEARTBEAT), Verdict.UNSIGNED)


def test_16_downgrade_to_mavlink_1(clock: Clock) -> None:
    frame = HEARTBEAT.pack(mavlink.MAVLink(None, srcSystem=1, srcComponent=1), force_mavlink1=True)
    assert refused(make(clock), frame, Verdict.MAVLINK_1)


def test_17_the_signed_flag_cleared_and_the_signature_cut_off(clock: Clock) -> None:
    frame = bytearray(sign()[:-13])
    frame[2] = 0
    crc = mavlink.x25crc(bytes(frame[1:-2]) + bytes([50])).crc
    frame[-2:] = crc.to_bytes(2, "little")
    assert refused(make(clock), bytes(frame), Verdict.UNSIGNED)


def test_18_the_same_frame_twice(clock: Clock) -> None:
    codec = make(clock)
    assert taken(codec, sign())
    assert refused(codec, sign(), Verdict.REPLAYED)


def test_19_an_older_frame_of_a_known_stream(clock: Clock) -> None:
    codec = make(clock)
    assert taken(codec, sign(stamp=NOW))
    assert refused(codec, sign(stamp=NOW - 1), Verdict.REPLAYED)
    assert taken(codec, sign(stamp=NOW + 1))


def test_20_a_replay_an_hour_later(clock: Clock) -> None:
    codec = make(clock)
    frame = sign()
    assert taken(codec, frame)
    clock.advance(3600)
    assert refused(codec, frame, Verdict.REPLAYED)


def test_21_a_recorded_frame_replayed_under_another_link_id(clock: Clock) -> None:
    codec = make(clock)
    frame = bytearray(sign())
    assert taken(codec, bytes(frame))
    frame[-13] = 7
    assert refused(codec, bytes(frame), Verdict.WRONG_SIGNATURE)


def test_22_a_frame_replayed_as_from_another_system(clock: Clock) -> None:
    codec = make(clock)
    frame = bytearray(sign())
    frame[5] = 2
    crc = mavlink.x25crc(bytes(frame[1:-15]) + bytes([50])).crc
    frame[-15:-13] = crc.to_bytes(2, "little")
    assert refused(codec, bytes(frame), Verdict.WRONG_SIGNATURE)


def test_23_a_new_stream_more_than_a_minute_behind(clock: Clock) -> None:
    codec = make(clock)
    assert NEW_STREAM_BEHIND_UNITS == 6_000_000  # a minute in units of 10 us
    assert refused(codec, sign(stamp=NOW - NEW_STREAM_BEHIND_UNITS - 1), Verdict.TOO_OLD)


def test_24_a_new_stream_just_within_the_minute(clock: Clock) -> None:
    """ArduPilot took 50 s behind on a new link id."""
    assert taken(make(clock), sign(stamp=NOW - NEW_STREAM_BEHIND_UNITS))


def test_25_an_old_stamp_may_go_on_in_a_known_stream(clock: Clock) -> None:
    """ArduPilot's stamps rise by one a frame: an hour later it is an hour behind, and still genuine."""
    codec = make(clock)
    assert taken(codec, sign(stamp=NOW))
    clock.advance(3600)
    assert taken(codec, sign(stamp=NOW + 1))


def test_26_streams_are_apart_by_link_system_and_component(clock: Clock) -> None:
    codec = make(clock)
    assert taken(codec, sign(stamp=NOW + 50))
    for options in ({"link_id": 1}, {"system": 2}, {"component": 154}):
        assert taken(codec, sign(stamp=NOW, **options))  # type: ignore[arg-type]
        assert refused(codec, sign(stamp=NOW, **options), Verdict.REPLAYED)  # type: ignore[arg-type]


# ---------------------------------------------------------------- poison


def test_27_a_forged_far_future_stamp_does_not_silence_the_genuine_stream(clock: Clock) -> None:
    """Stock stores the stamp before it verifies: the genuine one is rejected for good."""
    codec = make(clock)
    assert refused(codec, sign(stamp=MAX_STAMP, secret=WRONG), Verdict.WRONG_SIGNATURE)
    assert taken(codec, sign(stamp=NOW))
    assert refused(codec, sign(stamp=MAX_STAMP, secret=WRONG), Verdict.WRONG_SIGNATURE)
    assert taken(codec, sign(stamp=NOW + 1))


def test_28_the_stock_fault_is_real(clock: Clock) -> None:
    """The witness for the test above: pymavlink's own receiver is silenced by the same two frames."""
    stock = common.MAVLink(None)
    stock.robust_parsing = True
    stock.signing.secret_key, stock.signing.timestamp = SECRET, NOW
    (forged,) = stock.parse_buffer(sign(stamp=MAX_STAMP, secret=WRONG))
    (genuine,) = stock.parse_buffer(sign(stamp=NOW + 1))
    assert (forged.get_type(), genuine.get_type()) == ("BAD_DATA", "BAD_DATA")


def test_29_forged_frames_move_neither_stamps_nor_store(clock: Clock) -> None:
    store = SigningStore.in_memory()
    codec = make(clock, store=store)
    codec.encode(HEARTBEAT)
    for stamp in (0, NOW, MAX_STAMP):
        for link_id in range(40):
            codec.decode(sign(stamp=stamp, secret=WRONG, link_id=link_id))
    assert store.own_stamp == NOW
    assert store.last_stamp((0, 1, 1)) is None
    assert stamp_of(codec.encode(HEARTBEAT)) == NOW + 1


def test_30_forged_frames_cannot_fill_the_table(clock: Clock) -> None:
    codec = make(clock)
    for link_id in range(256):
        for system in (1, 2, 3):
            codec.decode(sign(secret=WRONG, link_id=link_id, system=system))
    assert taken(codec, sign())


def test_31_a_full_table_refuses_new_streams_and_keeps_the_known(clock: Clock) -> None:
    codec = make(clock)
    for system in range(1, 256):
        if system != 241:
            assert taken(codec, sign(system=system))
    assert taken(codec, sign(system=1, component=2))
    assert refused(codec, sign(system=1, component=3), Verdict.TOO_MANY_STREAMS)
    assert taken(codec, sign(stamp=NOW + 1))


# ---------------------------------------------------------------- our own stamp and theirs


def test_32_a_vehicle_a_minute_ahead_is_followed(clock: Clock) -> None:
    """ArduPilot's stamps start exactly 60 s ahead of the one it was given."""
    codec = make(clock)
    ahead = NOW + 60 * UNITS_PER_S
    assert taken(codec, sign(stamp=ahead))
    assert stamp_of(codec.encode(HEARTBEAT)) == ahead + 1
    assert codec.signing is not None
    assert codec.signing.stamp == ahead + 1
    assert (codec.signing.stamp - clock()) / UNITS_PER_S == pytest.approx(60.0, abs=0.01)
    clock.advance(3600)
    assert codec.signing.stamp < clock()


def test_33_following_does_not_go_back(clock: Clock) -> None:
    codec = make(clock)
    first = stamp_of(codec.encode(HEARTBEAT))
    assert taken(codec, sign(stamp=NOW - 1000))
    assert stamp_of(codec.encode(HEARTBEAT)) == first + 1


def test_34_a_vehicle_that_keeps_a_new_stream_to_a_minute_takes_us_after_we_heard_it(clock: Clock) -> None:
    """Its clock is two hours ahead; we would be refused as a new stream at wall clock, and are not."""
    ours, theirs = make(clock), vehicle(Clock(NOW + 7200 * UNITS_PER_S))
    theirs.encode(HEARTBEAT)
    assert refused(theirs, ours.encode(HEARTBEAT), Verdict.TOO_OLD)
    assert taken(ours, theirs.encode(HEARTBEAT))
    assert taken(theirs, ours.encode(HEARTBEAT))


def test_34b_a_stamp_from_the_end_of_time_is_not_followed(clock: Clock) -> None:
    """A broken clock that holds the key: after its last stamp we would have none left, and wrap to 2015."""
    codec = make(clock)
    assert refused(codec, sign(stamp=MAX_STAMP), Verdict.NO_STAMPS_LEFT)
    assert stamp_of(codec.encode(HEARTBEAT)) == NOW
    assert taken(codec, sign(stamp=MAX_STAMP - 86_400 * UNITS_PER_S))


# ---------------------------------------------------------------- restarts


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "texel.stamps"


@contextlib.contextmanager
def stored(path: Path) -> Iterator[SigningStore]:
    store = SigningStore.open(path)
    try:
        yield store
    finally:
        store.close()


def test_35_a_frame_replayed_to_a_restarted_station(clock: Clock, path: Path) -> None:
    """Within the minute in which stock accepts it."""
    frame = sign()
    with stored(path) as store:
        assert taken(make(clock, store=store), frame)
    clock.advance(5)
    with stored(path) as store:
        assert refused(make(clock, store=store), frame, Verdict.REPLAYED)


def test_35b_every_stream_survives_a_restart(clock: Clock, path: Path) -> None:
    streams = [
        {"link_id": link_id, "system": system, "component": component}
        for link_id in (0, 7, 255)
        for system in (1, 200)
        for component in (1, 154)
    ]
    with stored(path) as store:
        codec = make(clock, store=store)
        for i, stream in enumerate(streams):
            assert taken(codec, sign(stamp=NOW + i, **stream))
    with stored(path) as store:
        codec = make(clock, store=store)
        for i, stream in enumerate(streams):
            assert refused(codec, sign(stamp=NOW + i, **stream), Verdict.REPLAYED)
            assert taken(codec, sign(stamp=NOW + i + 1, **stream))


def test_36_a_genuine_stream_goes_on_after_our_restart(clock: Clock, path: Path) -> None:
    """Also one whose stamps rise by one a frame: a reserve taken in advance would have locked it out."""
    with stored(path) as store:
        assert taken(make(clock, store=store), sign(stamp=NOW))
    clock.advance(3600)
    with stored(path) as store:
        assert taken(make(clock, store=store), sign(stamp=NOW + 1))


def test_37_our_stamp_goes_on_after_a_restart(clock: Clock, path: Path) -> None:
    """A station that had followed a vehicle a minute ahead and restarts at wall clock would be dropped for a minute."""
    with stored(path) as store:
        codec = make(clock, store=store)
        codec.decode(sign(stamp=NOW + 60 * UNITS_PER_S))
        last = stamp_of(codec.encode(HEARTBEAT))
    clock.advance(2)
    with stored(path) as store:
        assert stamp_of(make(clock, store=store).encode(HEARTBEAT)) == last + 1


def test_38_a_restart_with_the_clock_set_back(clock: Clock, path: Path) -> None:
    with stored(path) as store:
        last = stamp_of(make(clock, store=store).encode(HEARTBEAT))
    clock.advance(-86_400)
    with stored(path) as store:
        assert stamp_of(make(clock, store=store).encode(HEARTBEAT)) == last + 1


def _sign_until_killed(path: str, pipe: Any) -> None:
    store = SigningStore.open(path)
    codec = make(lambda: NOW, store=store)
    sequence = 0
    while True:
        codec.decode(sign(stamp=NOW + sequence))
        frame = codec.encode(HEARTBEAT)
        pipe.send((stamp_of(frame), NOW + sequence))
        sequence += 1


@pytest.mark.parametrize("seed", range(3))
def test_39_a_station_killed_at_any_instant_repeats_no_stamp(path: Path, seed: int) -> None:
    """SIGKILL while signing and listening at full speed; the last stamps it told of are not used or taken again."""
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe(duplex=False)
    process = context.Process(target=_sign_until_killed, args=(str(path), theirs))
    process.start()
    theirs.close()
    count = random.Random(seed).randrange(200, 2000)
    for _ in range(count):
        sent, heard = ours.recv()
    process.kill()
    with contextlib.suppress(EOFError):
        while True:
            sent, heard = ours.recv()
    process.join()
    with stored(path) as store:
        codec = make(lambda: NOW, store=store)
        assert refused(codec, sign(stamp=heard), Verdict.REPLAYED)
        assert stamp_of(codec.encode(HEARTBEAT)) > sent


def test_40_two_processes_cannot_share_a_stations_stamps(path: Path) -> None:
    with stored(path):
        code = f"from link.wire.signing_timestamps import SigningStore; SigningStore.open({str(path)!r})"
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
        assert done.returncode == 1
        assert "is in use by another process" in done.stderr
    SigningStore.open(path).close()


@pytest.mark.parametrize(
    "damage",
    [
        lambda path: path.write_bytes(b"x" * 4096),
        lambda path: path.write_bytes(path.read_bytes()[:100]),
        lambda path: path.write_bytes(path.read_bytes() + b"more"),
        lambda path: path.write_bytes(b"\0" * 4097),
        lambda path: path.write_bytes(b"\0" * 8 + path.read_bytes()[8:]),
    ],
)
def test_41_a_damaged_state_is_refused_not_guessed(clock: Clock, path: Path, damage: Callable[[Path], None]) -> None:
    with stored(path) as store:
        make(clock, store=store).encode(HEARTBEAT)
    good = path.read_bytes()
    damage(path)
    with pytest.raises(SigningError, match=r"damaged or not ours: restore it"):
        SigningStore.open(path)
    # Restored in place: usable again, by this process too.
    path.write_bytes(good)
    with stored(path) as store:
        assert store.own_stamp == NOW


def test_42_a_state_file_left_empty_by_a_crash_at_birth_is_a_new_one(path: Path) -> None:
    path = path.parent / "not" / "there" / "yet"
    for content in (None, b"", b"\0" * 4096, b"\0" * 17):
        if content is not None:
            path.write_bytes(content)
        with stored(path) as store:
            assert store.own_stamp == 0
        assert path.stat().st_size == 4096
        path.unlink()


def test_43_a_state_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(SigningError, match="give a writable place"):
        SigningStore.open(tmp_path / "file" / "texel.stamps")
    with pytest.raises(SigningError, match="directory"):
        SigningStore.open(tmp_path)


def test_44_the_state_file_is_private_and_holds_no_key(clock: Clock, path: Path) -> None:
    with stored(path) as store:
        make(clock, store=store).encode(HEARTBEAT)
    assert path.stat().st_mode & 0o777 == 0o600
    assert SECRET not in path.read_bytes()


def test_45_a_closed_store_still_counts(clock: Clock, path: Path) -> None:
    """A station shutting down may still send a last frame."""
    with stored(path) as store:
        codec = make(clock, store=store)
        first = stamp_of(codec.encode(HEARTBEAT))
    assert stamp_of(codec.encode(HEARTBEAT)) == first + 1
    store.close()


# ---------------------------------------------------------------- unsigned by permission


def test_46_what_is_allowed_unsigned_is_taken_and_not_marked_signed(clock: Clock) -> None:
    """RADIO_STATUS comes from a modem that holds no key."""
    codec = make(clock, allow=(109,))
    (got,) = codec.decode(StationCodec(51, 68).encode(RADIO_STATUS))
    assert not got.get_signed()
    assert refused(codec, StationCodec(51, 68).encode(HEARTBEAT), Verdict.UNSIGNED)


def test_47_a_wrong_signature_is_no_better_than_none_even_where_none_is_allowed(clock: Clock) -> None:
    """Stock asks the same permission for both."""
    codec = make(clock, allow=(109,))
    assert refused(codec, sign(RADIO_STATUS, secret=WRONG), Verdict.WRONG_SIGNATURE)
    assert taken(codec, sign(RADIO_STATUS))
    assert refused(codec, sign(RADIO_STATUS), Verdict.REPLAYED)


def test_48_nothing_is_allowed_unsigned_by_default(clock: Clock) -> None:
    codec = make(clock)
    for message in (HEARTBEAT, RADIO_STATUS):
        assert refused(codec, StationCodec(1, 1).encode(message), Verdict.UNSIGNED)


def test_49_unsigned_frames_of_an_unknown_message_are_not_handed_on(clock: Clock) -> None:
    """Stock returns UNKNOWN_n before it looks at the signature at all."""
    other = ardupilotmega.MAVLink(None, srcSystem=1, srcComponent=1)
    frame = ardupilotmega.MAVLink_wind_message(90.0, 5.0, 0.1).pack(other)
    codec = make(clock, allow=(168,))
    assert codec.decode(frame) == []
    assert codec.stats.unknown_messages == 1


def test_50_signed_setup_signing_is_not_handed_on(clock: Clock) -> None:
    message = mavlink.MAVLink_setup_signing_message(241, 190, WRONG, NOW)
    assert refused(make(clock), sign(message), Verdict.SETUP_SIGNING)


def test_51_our_own_signed_frames_reflected_are_dropped(clock: Clock) -> None:
    codec = make(clock)
    assert codec.decode(codec.encode(HEARTBEAT)) == []
    assert codec.stats.echoes == 1


def test_52_refused_frames_do_not_count_as_loss_or_traffic(clock: Clock) -> None:
    """A stranger cannot make the link look bad, or good."""
    codec = make(clock)
    assert taken(codec, sign(sequence=0))
    for sequence in (50, 90, 130):
        codec.decode(sign(secret=WRONG, sequence=sequence))
    assert taken(codec, sign(stamp=NOW + 1, sequence=1))
    assert (codec.stats.sources[1, 1].lost, codec.stats.sources[1, 1].received) == (0, 2)


def test_53_without_a_key_signed_frames_are_read_but_not_called_signed() -> None:
    codec = StationCodec(241)
    (got,) = codec.decode(sign(secret=WRONG))
    assert not got.get_signed()


def test_54_a_signed_frame_is_judged_whole_wherever_the_stream_is_cut(clock: Clock) -> None:
    data = sign() + sign(stamp=NOW + 1, sequence=1)
    for cut in range(len(data)):
        codec = make(clock)
        codec.stream = True
        got = codec.decode(data[:cut]) + codec.decode(data[cut:])
        assert len(got) == 2


# ---------------------------------------------------------------- the recorded vehicle


def test_55_the_stamps_of_a_real_vehicle_pass(clock: Clock) -> None:
    """ArduPilot's stamps as recorded: 60 s ahead, then one a frame. Signed here, for keys are not in recordings."""
    codec = make(clock)
    stamps = [
        (m["signed"]["timestamp"], m["signed"]["link_id"], m["src"])
        for m in load("ardupilot-signing")[1]
        if m["dir"] == "rx" and "signed" in m
    ]
    assert len(stamps) > 50
    clock.stamp = stamps[0][0]
    last: dict[tuple[int, int, int], int] = {}
    for stamp, link_id, (system, component) in stamps:
        stream = (link_id, system, component)
        frame = sign(stamp=stamp, link_id=link_id, system=system, component=component)
        if stamp > last.get(stream, 0):
            assert taken(codec, frame)
            last[stream] = stamp
        else:
            assert refused(codec, frame, Verdict.REPLAYED)


# ---------------------------------------------------------------- keys


def test_56_a_key_never_shows_itself(clock: Clock, tmp_path: Path) -> None:
    signing = make(clock).signing
    assert signing is not None
    shown = [repr(KEY), str(KEY), f"{KEY}", repr(signing), repr(vars(signing)), repr([KEY])]
    with pytest.raises(TypeError) as pickling:
        pickle.dumps(KEY)
    shown.append(str(pickling.value))
    try:
        Signing(KEY, 999, SigningStore.in_memory())
    except ValueError:
        shown.append(traceback.format_exc())
    secret_forms = (SECRET.hex(), repr(SECRET), "\\x01\\x02\\x03")
    assert not any(form in text for text in shown for form in secret_forms)


def test_57_keys_from_file_and_environment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    forms = {
        "raw": SECRET,
        "hex": SECRET.hex().encode() + b"\n",
        "base64": b" AQIDBAUGBwgJCgsMDQ4PEBESExQVFhcYGRobHB0eHyA=\n",
    }
    for name, content in forms.items():
        path = tmp_path / name
        path.write_bytes(content)
        path.chmod(0o600)
        assert SigningKey.from_file(path) == SigningKey.from_file(str(path)) == KEY
    monkeypatch.setenv("RELAY_KEY", SECRET.hex())
    assert SigningKey.from_environment("RELAY_KEY") == KEY
    assert SigningKey.from_passphrase("spade") == SigningKey(hashlib.sha256(b"spade").digest())
    assert SigningKey(WRONG) != KEY
    with pytest.raises(TypeError, match="unhashable"):
        hash(KEY)


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o660, 0o666, 0o610])
def test_58_a_key_file_open_to_others_is_refused(tmp_path: Path, mode: int) -> None:
    path = tmp_path / "key"
    path.write_bytes(SECRET)
    path.chmod(mode)
    with pytest.raises(SigningKeyError, match=rf"open to others \(mode {mode:o}\): chmod 600"):
        SigningKey.from_file(path)


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (b"", "64 hexadecimal digits or the base64|32 bytes, this one has 0"),
        (b"x" * 31, "64 hexadecimal digits or the base64"),
        (b"zz" * 32, "must be hexadecimal"),
        (b"AQID", "32 bytes, this one has 3"),
        (b"AQIDBAUGBwgJCgsMDQ4PEBESExQVFhcYGRobHB0eHy!A=", "64 hexadecimal digits or the base64"),
        (b"\xff" * 40, "neither a key nor text"),
        (bytes(32), "zeros means 'signing off'"),
        (b"00" * 32, "zeros means 'signing off'"),
    ],
)
def test_59_bad_keys_are_refused_without_being_shown(tmp_path: Path, content: bytes, problem: str) -> None:
    path = tmp_path / "key"
    path.write_bytes(content)
    path.chmod(0o600)
    with pytest.raises(SigningKeyError, match=problem) as caught:
        SigningKey.from_file(path)
    text = "".join(traceback.format_exception(caught.value))
    assert "zzzz" not in text
    assert "xxxx" not in text


def test_60_missing_keys_say_where_to_put_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(SigningKeyError, match="No such file"):
        SigningKey.from_file(tmp_path / "nowhere")
    monkeypatch.delenv("RELAY_KEY", raising=False)
    with pytest.raises(SigningKeyError, match="RELAY_KEY is not set: put the signing key there"):
        SigningKey.from_environment("RELAY_KEY")
    monkeypatch.setenv("RELAY_KEY", "tooshort")
    with pytest.raises(SigningKeyError, match="environment variable RELAY_KEY") as caught:
        SigningKey.from_environment("RELAY_KEY")
    assert "tooshort" not in "".join(traceback.format_exception(caught.value))
    with pytest.raises(SigningKeyError, match="64 hexadecimal digits or the base64"):
        SigningKey.from_text("schlüssel")
    with pytest.raises(SigningKeyError, match="empty passphrase"):
        SigningKey.from_passphrase("")


@pytest.mark.parametrize("link_id", [-1, 256])
def test_61_impossible_link_ids(link_id: int) -> None:
    with pytest.raises(ValueError, match=r"link_id is .*, allowed is 0 to 255"):
        Signing(KEY, link_id, SigningStore.in_memory())
    for possible in (0, 255):
        assert Signing(KEY, possible, SigningStore.in_memory()).link_id == possible


def test_62_stations_of_one_process_at_full_speed_never_clash(clock: Clock, tmp_path: Path) -> None:
    """Three stations with one key and a store each, one vehicle: every frame of every station is taken, once."""
    stores = [SigningStore.open(tmp_path / str(s)) for s in (241, 242, 243)]
    stations = [make(clock, system=s, store=store) for s, store in zip((241, 242, 243), stores, strict=True)]
    them = vehicle(clock)
    rng = random.Random(3)
    for _ in range(600):
        clock.advance(rng.choice([0.0, 0.0, 0.02]))
        frame = rng.choice(stations).encode(HEARTBEAT)
        assert taken(them, frame)
        assert refused(them, frame, Verdict.REPLAYED)
        answer = them.encode(HEARTBEAT)
        for listener in stations:
            assert taken(listener, answer)
    for store in stores:
        store.close()
    assert sorted(os.listdir(tmp_path)) == ["241", "242", "243"]


DAY_UNITS = 8_640_000_000


def test_a_days_worth_of_stamps_before_the_end_of_their_range_is_kept_for_our_own() -> None:
    codec = make(Clock(NOW))
    assert refused(codec, sign(stamp=MAX_STAMP - DAY_UNITS + 1), Verdict.NO_STAMPS_LEFT)
    assert taken(codec, sign(stamp=MAX_STAMP - DAY_UNITS))
    assert stamp_of(codec.encode(HEARTBEAT)) == MAX_STAMP - DAY_UNITS + 1


def test_a_stream_stays_known_at_the_stamp_we_hold_ourselves() -> None:
    codec = make(Clock(NOW))
    assert taken(codec, sign(stamp=NOW))
    assert codec.signing is not None
    assert codec.signing.stamp == NOW
    # A new stream is held to our own stamp where that is ahead of the clock.
    assert taken(codec, sign(stamp=NOW + DAY_UNITS, link_id=1))
    assert refused(codec, sign(stamp=NOW + 1, link_id=2), Verdict.TOO_OLD)


# -- the file ---------------------------------------------------------------------------------------------------------


def in_memory() -> list[Path]:
    """The stamps that lie in shared memory."""
    return list(memory_file.FOLDER.glob("skyrelay-*"))


@pytest.fixture
def own_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Shared memory of this test's own."""
    folder = tmp_path / "memory"
    folder.mkdir()
    monkeypatch.setattr(memory_file, "FOLDER", folder)
    return folder


def reopened(store: SigningStore, path: Path) -> SigningStore:
    """The store after a restart."""
    store.close()
    return SigningStore.open(path)


@pytest.mark.usefixtures("own_memory")
def test_a_stamp_is_never_taken_for_a_stream_whatever_its_bits(tmp_path: Path) -> None:
    path = tmp_path / "new" / "folder" / "a.stamps"
    store = SigningStore.open(path)
    stamp = 1 << 24 | 3 << 16 | 2 << 8 | 1  # what marks the stream (3, 2, 1)
    store.own_stamp = stamp
    assert store.remember((9, 8, 7), stamp)
    store = reopened(store, path)
    assert (store.own_stamp, store.last_stamp((9, 8, 7)), store.last_stamp((3, 2, 1))) == (stamp, stamp, None)
    store.close()


@pytest.mark.usefixtures("own_memory")
def test_after_a_restart_each_stream_goes_on_in_its_own_place(tmp_path: Path) -> None:
    path = tmp_path / "a.stamps"
    store = SigningStore.open(path)
    streams = [(k, 1, 1) for k in range(3)]
    for stream in streams:
        store.remember(stream, 100 + stream[0])
    for restart in range(3):
        store = reopened(store, path)
        assert store.remember((2, 1, 1), 200 + restart)
        store = reopened(store, path)
        assert [store.last_stamp(stream) for stream in streams] == [100, 101, 200 + restart]
    # 255 streams and no more; the rest of the table is still free after all this.
    assert [store.remember((k, 2, 1), 1) for k in range(253)] == [True] * 252 + [False]
    store = reopened(store, path)
    assert [store.last_stamp(stream) for stream in streams] == [100, 101, 202]
    assert store.last_stamp((251, 2, 1)) == 1
    store.close()


@pytest.mark.usefixtures("own_memory")
def test_a_store_in_use_is_refused_and_goes_on(tmp_path: Path) -> None:
    path = tmp_path / "a.stamps"
    store = SigningStore.open(path)
    store.own_stamp = 5
    with pytest.raises(SigningError, match="is in use by another process; stop that one first"):
        SigningStore.open(path)
    store.own_stamp = 6
    store = reopened(store, path)
    assert store.own_stamp == 6
    store.close()


@pytest.mark.usefixtures("own_memory")
@pytest.mark.parametrize(
    "content",
    [
        b"S" + bytes(4095),
        bytes(4095) + b"1",
        bytes(4097),
        b"SKYSIGN1" + bytes(4080),
        b"SKYSIGN1" + bytes(4096),
        b"SKYSIGN2" + bytes(4088),
    ],
)
def test_a_file_that_is_no_store_is_refused_and_left_as_it_is(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "a.stamps"
    path.write_bytes(content)
    with pytest.raises(SigningError, match="is damaged or not ours"):
        SigningStore.open(path)
    assert path.read_bytes() == content


@pytest.mark.usefixtures("own_memory")
def test_a_disk_without_room_for_the_stamps_is_told_before_the_first_of_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.stamps"

    def full(*_: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(os, "posix_fallocate", full)
        with pytest.raises(SigningError, match="No space left on device; give a writable place"):
            SigningStore.open(path)
    # Let go of, so that it can be tried again; now it is there in full before a stamp is stored.
    store = SigningStore.open(path)
    assert path.stat().st_size == 4096
    assert path.read_bytes() == b"SKYSIGN1" + bytes(4088)
    store.close()


@pytest.mark.usefixtures("own_memory")
def test_a_new_store_is_on_the_disk_before_it_is_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.stamps"
    synced: list[bytes] = []
    monkeypatch.setattr(os, "fsync", lambda _: synced.append(path.read_bytes()))
    store = SigningStore.open(path)
    assert synced == [b"SKYSIGN1" + bytes(4088)]
    store.own_stamp = 7
    store.close()
    assert SigningStore.open(path).own_stamp == 7
    assert [synced[1][8], len(synced)] == [7, 2]


@pytest.mark.usefixtures("own_memory")
def test_a_closed_store_lets_go_of_its_file(tmp_path: Path) -> None:
    path = tmp_path / "a.stamps"
    store = SigningStore.open(path)
    store.remember((1, 1, 1), 7)
    assert in_memory()
    store.close()
    store.close()
    assert not in_memory()
    assert not [one for one in open_files() if one == str(path)]
    # What comes after is known to this process, and to nobody else.
    assert store.remember((1, 1, 1), 8)
    assert store.remember((2, 1, 1), 9)
    store.own_stamp = 10
    assert (store.own_stamp, store.last_stamp((1, 1, 1)), store.last_stamp((2, 1, 1))) == (10, 8, 9)
    again = SigningStore.open(path)
    assert (again.own_stamp, again.last_stamp((1, 1, 1)), again.last_stamp((2, 1, 1))) == (0, 7, None)
    again.close()


@pytest.mark.usefixtures("own_memory")
def test_stamps_kept_by_an_earlier_version_are_understood(tmp_path: Path) -> None:
    """The layout of the file, word by word: a magic number, our own stamp, then marks and stamps of streams."""
    words = [0x314E474953594B53, 1000, 0x01070201, 2000, 0x01FF0A9A, 3000]
    path = tmp_path / "a.stamps"
    path.write_bytes(b"".join(word.to_bytes(8, sys.byteorder) for word in words).ljust(4096, b"\0"))
    store = SigningStore.open(path)
    assert store.own_stamp == 1000
    assert [store.last_stamp(stream) for stream in ((7, 2, 1), (255, 10, 154))] == [2000, 3000]
    store.close()


def killed(store: SigningStore) -> None:
    """What is left of a store when its process is killed: memory and file as they are, and nothing locked."""
    assert store._file is not None
    os.close(store._file[1])
    store._file = None


@pytest.mark.usefixtures("own_memory")
def test_a_stamp_stored_is_there_after_a_kill_and_not_before_on_the_disk(tmp_path: Path) -> None:
    path = tmp_path / "a.stamps"
    store = SigningStore.open(path)
    store.own_stamp = 4
    assert store.remember((1, 1, 1), 5)
    before = path.read_bytes()
    assert before == b"SKYSIGN1" + bytes(4088)
    killed(store)
    store = SigningStore.open(path)
    assert (store.own_stamp, store.last_stamp((1, 1, 1))) == (4, 5)
    store.close()
    assert SigningStore.open(path).own_stamp == 4


def test_what_was_saved_outlives_the_memory(tmp_path: Path, own_memory: Path) -> None:
    """A power cut: the file as it was saved last."""
    path = tmp_path / "a.stamps"
    store = SigningStore.open(path)
    store.own_stamp = 4
    assert store.remember((1, 1, 1), 5)
    store.save()
    assert store.remember((1, 1, 1), 6)
    killed(store)
    for left in own_memory.iterdir():
        left.unlink()
    store = SigningStore.open(path)
    assert (store.own_stamp, store.last_stamp((1, 1, 1))) == (4, 5)
    store.close()
    store.save()  # as closed


@pytest.mark.usefixtures("own_memory")
@pytest.mark.parametrize(("own_in_file", "own"), [(9, 10), (12, 12)])
def test_the_newer_of_memory_and_file_counts_stream_by_stream(own_in_file: int, own: int, tmp_path: Path) -> None:
    """A file restored or used without shared memory since, beside what a killed process left."""
    path = tmp_path / "a.stamps"
    store = SigningStore.open(path)
    store.own_stamp = 10
    for stream, stamp in (((1, 1, 1), 11), ((2, 1, 1), 22)):
        assert store.remember(stream, stamp)
    killed(store)
    words = [0x314E474953594B53, own_in_file, 0x01020101, 33, 0x01030101, 44, 0x01010101, 10, 0x01040101, 0]
    path.write_bytes(b"".join(word.to_bytes(8, sys.byteorder) for word in words).ljust(4096, b"\0"))
    store = SigningStore.open(path)
    assert store.own_stamp == own
    assert [store.last_stamp((k, 1, 1)) for k in (1, 2, 3, 4)] == [11, 33, 44, 0]
    store = reopened(store, path)
    assert [store.last_stamp((k, 1, 1)) for k in (1, 2, 3, 4)] == [11, 33, 44, 0]
    store.close()


def test_the_memory_is_private_and_whoever_clears_it_away_does_no_harm(tmp_path: Path, own_memory: Path) -> None:
    store = SigningStore.open(tmp_path / "a.stamps")
    (memory,) = own_memory.iterdir()
    assert memory.stat().st_mode & 0o777 == 0o600
    assert len([one for one in open_files() if one == str(memory)]) == 1
    store.own_stamp = 10
    memory.unlink()
    store.close()
    assert SigningStore.open(tmp_path / "a.stamps").own_stamp == 10


def test_a_new_file_knows_nothing_of_an_old_ones_memory(tmp_path: Path, own_memory: Path) -> None:
    path = tmp_path / "a.stamps"
    store = SigningStore.open(path)
    store.own_stamp = 10
    killed(store)
    path.write_bytes(b"")  # the same file to the system, emptied
    assert len(in_memory()) == 1
    store = SigningStore.open(path)
    assert store.own_stamp == 0
    store.close()


def foreign(left: Path) -> None:
    os.chown(left, 12345, 12345)


def a_link(left: Path) -> None:
    left.unlink()
    left.symlink_to("/etc/passwd")


def of_another_size(left: Path) -> None:
    left.write_bytes(b"x" * 100)


def a_folder(left: Path) -> None:
    left.unlink()
    left.mkdir()


@pytest.mark.parametrize("spoil", [foreign, a_link, of_another_size, a_folder])
def test_memory_that_is_not_ours_is_left_alone_and_the_file_itself_used(
    spoil: Callable[[Path], None], tmp_path: Path, own_memory: Path
) -> None:
    path = tmp_path / "a.stamps"
    store = SigningStore.open(path)
    store.own_stamp = 10
    killed(store)
    (left,) = own_memory.iterdir()
    try:
        spoil(left)
    except PermissionError:
        pytest.skip("only root gives files away")
    before = left.lstat()
    store = SigningStore.open(path)
    assert store.own_stamp == 0
    store.own_stamp = 20
    assert path.read_bytes()[8] == 20  # at once: the file itself is mapped
    store.save()
    store.close()
    assert (left.lstat().st_ino, left.lstat().st_size) == (before.st_ino, before.st_size)
    assert SigningStore.open(path).own_stamp == 20


@pytest.mark.usefixtures("own_memory")
def test_without_shared_memory_the_file_itself_is_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(memory_file, "FOLDER", tmp_path / "none")
    path = tmp_path / "a.stamps"
    store = SigningStore.open(path)
    store.own_stamp = 10
    assert path.read_bytes()[8] == 10
    store = reopened(store, path)
    assert store.own_stamp == 10
    store.close()


@pytest.mark.usefixtures("own_memory")
def test_stamps_that_cannot_be_written_out_stay_in_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.stamps"
    store = SigningStore.open(path)
    store.own_stamp = 10

    def broken(*_: object) -> None:
        raise OSError(errno.EIO, "Input/output error")

    with monkeypatch.context() as patch:
        patch.setattr(os, "pwrite", broken)
        with pytest.raises(OSError, match="Input/output"):
            store.close()
    assert not [one for one in open_files() if one == str(path)]
    store = SigningStore.open(path)
    assert store.own_stamp == 10
    store.close()
