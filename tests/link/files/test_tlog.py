"""Telemetry logs: written so that a crash costs nothing, read whatever happened to them."""

from __future__ import annotations

import io
import os
import random
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink import mavutil
from pymavlink.dialects.v20 import ardupilotmega

from link.dialect import mavlink
from link.errors import TlogError
from link.files.tlog import TlogRecord, TlogWriter, read_tlog, record
from link.wire.codec import StationCodec
from link.wire.signing import Signing, SigningKey
from link.wire.signing_timestamps import SigningStore

START_US = 1_795_338_000_000_000


def attitude(number: int) -> bytes:
    codec = StationCodec(1, 1)
    return codec.encode(mavlink.MAVLink_attitude_message(number, 0.5, 0, 0, 0, 0, 0.25))


def some_records(count: int) -> list[bytes]:
    return [record(attitude(i), START_US + 50_000 * i) for i in range(count)]


def numbers(records: list[TlogRecord]) -> list[int]:
    return [r.message.time_boot_ms for r in records]


def test_a_recorder_without_a_clock() -> None:
    """Stamps from 1970 on are believed as long as record follows record."""
    data = b"".join(record(attitude(i), 1000 * i) for i in range(5))
    assert [r.time_utc_us for r in read_tlog(io.BytesIO(data))] == [0, 1000, 2000, 3000, 4000]


def test_record_by_hand() -> None:
    frame = attitude(7)
    assert record(frame, 0x0006_60D5_A1B2_C3D4) == bytes.fromhex("000660d5a1b2c3d4") + frame


def test_written_and_read_back(tmp_path: Path) -> None:
    path = tmp_path / "new" / "flight.tlog"
    with TlogWriter(path) as log:
        for i in range(500):
            assert log.write(attitude(i), START_US + 20_000 * i)
        assert log.written == 500
    records = list(read_tlog(path))
    assert numbers(records) == list(range(500))
    assert [r.time_utc_us for r in records] == [START_US + 20_000 * i for i in range(500)]
    assert records[3].frame == attitude(3)
    assert records[3].time_utc_s == 1_795_338_000.06


def test_a_flight_a_file_and_a_name_that_is_taken_is_numbered(tmp_path: Path) -> None:
    path = tmp_path / "flight.tlog"
    for i in range(3):
        with TlogWriter(path) as log:
            log.write(attitude(i), START_US + i)
        assert log.path.name == ("flight.tlog", "flight-2.tlog", "flight-3.tlog")[i]
        assert numbers(list(read_tlog(log.path))) == [i]
    assert numbers(list(read_tlog(path))) == [0]


def test_mavutil_reads_it(tmp_path: Path) -> None:
    path = tmp_path / "flight.tlog"
    with TlogWriter(path) as log:
        for i in range(20):
            log.write(attitude(i), START_US + 1_000_000 * i)
    reader = mavutil.mavlink_connection(str(path), dialect="common")
    times = []
    while (message := reader.recv_match(type="ATTITUDE")) is not None:
        times.append((message.time_boot_ms, message._timestamp))
    reader.close()
    assert times == [(i, pytest.approx(1_795_338_000 + i)) for i in range(20)]


def test_signed_frames_and_mavlink_1_and_unknown_messages(tmp_path: Path) -> None:
    signing = Signing(SigningKey(bytes(range(1, 33))), 1, SigningStore.in_memory())
    signed = StationCodec(241, signing=signing).encode(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
    old = mavlink.MAVLink_heartbeat_message(2, 3, 0, 5, 4, 3).pack(mavlink.MAVLink(None, 1, 1), force_mavlink1=True)
    other = ardupilotmega.MAVLink_wind_message(90.0, 5.0, 0.1).pack(ardupilotmega.MAVLink(None, 1, 1))
    path = tmp_path / "flight.tlog"
    with TlogWriter(path) as log:
        for i, frame in enumerate((signed, old, other, attitude(9))):
            log.write(frame, START_US + i)
    a, b, c, d = read_tlog(path)
    assert (a.frame, a.message.get_srcSystem()) == (signed, 241)
    assert b.message.custom_mode == 5
    assert (c.frame, c.message) == (other, None)
    assert c.time_utc_us == START_US + 2
    assert d.message.time_boot_ms == 9


# ---------------------------------------------------------------- damage


@pytest.mark.parametrize("cut", range(1, 46))
def test_a_cut_tail_costs_the_last_record_alone(cut: int) -> None:
    data = b"".join(some_records(3))
    assert numbers(list(read_tlog(io.BytesIO(data[:-cut])))) == [0, 1]


@given(st.integers(0, 2**32))
def test_damage_costs_what_it_hits(seed: int) -> None:
    """A stretch overwritten, bytes lost or noise inserted in the middle: the rest is read."""
    rng = random.Random(seed)
    pieces = some_records(40)
    lengths = [len(p) for p in pieces]
    data = bytearray(b"".join(pieces))
    begin = rng.randrange(len(data) // 4, len(data) // 2)
    size = rng.randrange(1, 90)
    action = rng.randrange(3)
    if action == 0:
        data[begin : begin + size] = rng.randbytes(size)
    elif action == 1:
        del data[begin : begin + size]
    else:
        data[begin:begin] = rng.randbytes(size)
        size = 0
    # A message id hit by the damage makes a record of an unknown message: no worse than a lost one.
    got = numbers([r for r in read_tlog(io.BytesIO(bytes(data))) if r.message is not None])
    ends = [sum(lengths[: i + 1]) for i in range(40)]
    intact = [i for i in range(40) if ends[i] <= begin or ends[i] - lengths[i] >= begin + size]
    # A stray marker may cost one more record behind the damage.
    assert len(set(intact) - set(got)) <= 1
    assert set(got) <= set(range(40))


def test_a_log_larger_than_one_block(tmp_path: Path) -> None:
    path = tmp_path / "flight.tlog"
    frame = attitude(1)
    path.write_bytes(b"".join(record(frame, START_US + i) for i in range(30_000)))
    assert path.stat().st_size > 1 << 20
    assert [r.time_utc_us - START_US for r in read_tlog(path)] == list(range(30_000))


def test_what_is_no_log_says_so(tmp_path: Path) -> None:
    path = tmp_path / "plan.json"
    path.write_text('{"name": "a plan"}' * 100)
    with pytest.raises(TlogError, match=r"plan.json is no telemetry log: not one MAVLink frame .* in 1800 bytes"):
        list(read_tlog(path))
    with pytest.raises(TlogError, match="No such file"):
        list(read_tlog(tmp_path / "missing.tlog"))
    assert list(read_tlog(io.BytesIO())) == []


def test_a_raw_stream_without_times_is_no_log() -> None:
    with pytest.raises(TlogError, match="no telemetry log"):
        list(read_tlog(io.BytesIO(b"".join(attitude(i) for i in range(20)))))


# ---------------------------------------------------------------- writing in bad times


def test_a_killed_writer_loses_nothing(tmp_path: Path) -> None:
    path = tmp_path / "flight.tlog"
    code = (
        "import sys, time\n"
        "from link.files.tlog import TlogWriter\n"
        "from link.wire.codec import StationCodec\n"
        "from link.dialect import mavlink\n"
        f"log = TlogWriter({str(path)!r})\n"
        "codec = StationCodec(1, 1)\n"
        "for i in range(100):\n"
        f"    log.write(codec.encode(mavlink.MAVLink_attitude_message(i, 0, 0, 0, 0, 0, 0)), {START_US} + i)\n"
        "print('written', flush=True)\n"
        "time.sleep(60)\n"
    )
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as writer:
        assert writer.stdout is not None
        assert writer.stdout.readline() == "written\n"
        writer.send_signal(signal.SIGKILL)
    assert numbers(list(read_tlog(path))) == list(range(100))


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="needs /dev/full")
def test_a_full_disk_does_not_disturb_a_flight() -> None:
    with TlogWriter("/dev/full", tolerant=True) as log:
        assert not log.write(attitude(0), START_US)
        assert not log.write(attitude(1), START_US)
        assert (log.written, log.dropped, log.last_error) == (0, 2, "No space left on device")


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="needs /dev/full")
def test_a_full_disk_is_an_error_where_the_log_is_the_purpose() -> None:
    with TlogWriter("/dev/full") as log, pytest.raises(TlogError, match="No space left on device; free space"):
        log.write(attitude(0), START_US)


def test_writing_after_closing_is_dropped(tmp_path: Path) -> None:
    log = TlogWriter(tmp_path / "x.tlog", tolerant=True)
    log.close()
    log.close()
    assert not log.write(attitude(0), START_US)
    assert log.dropped == 1


def test_a_place_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(TlogError, match="give a writable place"):
        TlogWriter(tmp_path / "file" / "x.tlog")


@pytest.mark.parametrize("time_us", [-1, 5_000_000_000_000_000])
def test_impossible_times_are_refused(time_us: int) -> None:
    with pytest.raises(TlogError, match="outside 1970 to 2100"):
        record(attitude(0), time_us)
