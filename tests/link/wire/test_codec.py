"""Bytes to messages: nothing the air can do to a stream costs more than the frame it hit."""

from __future__ import annotations

import dataclasses
import random
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega, common

from link.dialect import mavlink
from link.errors import ParameterError, SigningError
from link.microservices.parameter_value import Encoding, Parameter, encoding_of, read_parameter, write_parameter
from link.wire.codec import SourceStats, StationCodec

HEARTBEAT = mavlink.MAVLink_heartbeat_message(2, 3, 81, 4, 4, 3)


def attitude(time_ms: int) -> Any:
    return mavlink.MAVLink_attitude_message(time_ms, 0.1, -0.2, 3.0, 0.01, 0.02, 0.03)


def vehicle_frames(count: int, *, start: int = 0) -> list[bytes]:
    """Frames of system 1, numbered by their time."""
    codec = StationCodec(1, 1)
    frames = [codec.encode(attitude(1_000_000 + i)) for i in range(start + count)]
    return frames[start:]


def numbers(messages: list[Any]) -> list[int]:
    return [m.time_boot_ms - 1_000_000 for m in messages]


def station(*, stream: bool = False) -> StationCodec:
    return StationCodec(241, stream=stream)


# ---------------------------------------------------------------- encoding


def test_frame_by_hand() -> None:
    frame = StationCodec(241, 190).encode(HEARTBEAT)
    assert frame[:10] == bytes([0xFD, 9, 0, 0, 0, 241, 190, 0, 0, 0])
    assert len(frame) == 10 + 9 + 2
    (got,) = StationCodec(1, 1).decode(frame)
    assert (got.get_type(), got.type, got.custom_mode, got.get_srcSystem(), got.get_srcComponent()) == (
        "HEARTBEAT",
        2,
        4,
        241,
        190,
    )


def test_each_station_counts_its_own_frames_and_wraps() -> None:
    a, b = StationCodec(241), StationCodec(242)
    assert [a.encode(HEARTBEAT)[4] for _ in range(258)] == [*range(256), 0, 1]
    assert b.encode(HEARTBEAT)[4] == 0
    assert (a.sequence, b.sequence, a.stats.sent) == (2, 1, 258)


def test_the_stock_parser_reads_ours_and_we_read_the_stock_ones() -> None:
    stock = common.MAVLink(None, srcSystem=1, srcComponent=1)
    (got,) = stock.parse_buffer(StationCodec(241).encode(attitude(77)))
    assert (got.get_type(), got.time_boot_ms, got.get_srcSystem()) == ("ATTITUDE", 77, 241)
    (back,) = station().decode(common.MAVLink_attitude_message(78, 0, 0, 0, 0, 0, 0).pack(stock))
    assert back.time_boot_ms == 78


@pytest.mark.parametrize("ids", [(0, 190), (256, 190), (241, 0), (241, 256), (-1, 1)])
def test_impossible_ids_are_refused(ids: tuple[int, int]) -> None:
    with pytest.raises(ValueError, match="allowed is 1 to 255"):
        StationCodec(*ids)


def test_setup_signing_never_takes_this_road() -> None:
    codec = station()
    with pytest.raises(SigningError, match="carries the key"):
        codec.encode(mavlink.MAVLink_setup_signing_message(1, 1, bytes(range(32)), 0))
    assert codec.stats.sent == 0
    assert codec.sequence == 0


# ---------------------------------------------------------------- decoding


def test_several_frames_in_one_datagram() -> None:
    codec = station()
    assert numbers(codec.decode(b"".join(vehicle_frames(5)))) == [0, 1, 2, 3, 4]
    assert (codec.stats.received, codec.stats.garbage_bytes) == (5, 0)


def test_mavlink_1_is_read() -> None:
    old = common.MAVLink(None, srcSystem=1, srcComponent=1)
    frame = common.MAVLink_heartbeat_message(2, 12, 81, 393216, 4, 3).pack(old, force_mavlink1=True)
    assert frame[0] == 0xFE
    (got,) = station().decode(frame)
    assert got.custom_mode == 393216


@pytest.mark.parametrize("cut", range(1, 38))
def test_a_cut_datagram_costs_itself_alone(cut: int) -> None:
    """The stock parser waits for the rest and swallows the next datagram with it."""
    codec = station()
    first, second = vehicle_frames(2)
    assert codec.decode(first[:cut]) == []
    assert numbers(codec.decode(second)) == [1]


@pytest.mark.parametrize("cut", range(38))
def test_a_stream_goes_on_where_it_was_cut(cut: int) -> None:
    codec = station(stream=True)
    data = b"".join(vehicle_frames(3))
    got = codec.decode(data[:cut]) + codec.decode(data[cut : cut + 40]) + codec.decode(data[cut + 40 :])
    assert numbers(got) == [0, 1, 2]
    assert codec.stats.garbage_bytes == 0


def test_a_stream_byte_by_byte() -> None:
    codec = station(stream=True)
    data = b"".join(vehicle_frames(3))
    assert numbers([m for byte in data for m in codec.decode(bytes([byte]))]) == [0, 1, 2]


@given(
    st.lists(st.binary(max_size=60).filter(lambda b: 0xFD not in b and 0xFE not in b), min_size=4, max_size=4),
    st.booleans(),
)
def test_noise_between_frames_costs_no_frame(noise: list[bytes], stream: bool) -> None:
    frames = vehicle_frames(3)
    data = noise[0] + frames[0] + noise[1] + frames[1] + noise[2] + frames[2] + noise[3]
    codec = station(stream=stream)
    assert numbers(codec.decode(data)) == [0, 1, 2]
    assert codec.stats.garbage_bytes == sum(map(len, noise))


@pytest.mark.parametrize(
    "stray", [b"\xfd\xff\x00\x00", b"\xfd\xff\x00\x00\x05\x01\x01\x1e\x00\x00", b"\xfe\xff", b"\xfd"]
)
def test_a_stray_marker_does_not_swallow_the_frames_behind_it(stray: bytes) -> None:
    """A marker and a length of 255: the stock parser takes the 280 bytes that follow for its payload."""
    codec = station(stream=True)
    got = codec.decode(stray + b"".join(vehicle_frames(30)))
    assert numbers(got) == list(range(30))
    assert codec.stats.garbage_bytes == len(stray)


@pytest.mark.parametrize("position", range(38))
@pytest.mark.parametrize("bit", [0, 7])
def test_a_flipped_bit_costs_one_frame(position: int, bit: int) -> None:
    frames = vehicle_frames(3)
    hurt = bytearray(frames[1])
    if position >= len(hurt):
        pytest.skip("shorter frame")
    hurt[position] ^= 1 << bit
    codec = station()
    assert numbers(codec.decode(frames[0] + bytes(hurt) + frames[2])) == [0, 2]


def test_flags_of_another_protocol_version_are_no_frame() -> None:
    frame = bytearray(vehicle_frames(1)[0])
    frame[2] = 0x02
    codec = station()
    assert codec.decode(bytes(frame)) == []
    assert codec.stats.received == 0


def test_a_mavlink_1_payload_longer_than_its_message_is_no_frame() -> None:
    """MAVLink 1 has no extensions: a heartbeat of 200 bytes is noise, and is not waited for."""
    codec = station(stream=True)
    assert numbers(codec.decode(bytes([0xFE, 200, 0, 1, 1, 0]) + vehicle_frames(1)[0])) == [0]
    assert codec.stats.garbage_bytes == 6


def test_unknown_messages_are_dropped_and_counted() -> None:
    """Stock hands them on unchecked as UNKNOWN_n. Here another dialect's message (ardupilotmega's WIND, 168)."""
    other = ardupilotmega.MAVLink(None, srcSystem=1, srcComponent=1)
    unknown = ardupilotmega.MAVLink_wind_message(90.0, 5.0, 0.1).pack(other)
    frames = vehicle_frames(2)
    codec = station()
    assert numbers(codec.decode(frames[0] + unknown + frames[1])) == [0, 1]
    assert (codec.stats.unknown_messages, codec.stats.garbage_bytes) == (1, 0)


def test_an_unknown_message_carries_no_frame_inside() -> None:
    """A whole good frame as payload of an unknown message (smuggling) is part of that message."""
    inner = vehicle_frames(1)[0]
    outer = bytes([0xFD, len(inner), 0, 0, 9, 1, 1, 0x99, 0x99, 0x01]) + inner + b"\x12\x34"
    codec = station()
    assert codec.decode(outer) == []
    assert codec.stats.unknown_messages == 1


def test_a_longer_payload_of_a_newer_dialect_is_read() -> None:
    """Extensions are added at the end; the fields we know keep their places."""
    codec = StationCodec(1, 1)
    frame = bytearray(codec.encode(mavlink.MAVLink_timesync_message(5, 7)))
    longer = frame[:10] + frame[10:-2].ljust(16, b"\0") + bytes([255, 190])
    longer[1] = 18
    crc = mavlink.x25crc(bytes(longer[1:]) + bytes([mavlink.MAVLink_timesync_message.crc_extra])).crc
    (got,) = station().decode(bytes(longer) + crc.to_bytes(2, "little"))
    assert (got.tc1, got.ts1) == (5, 7)


def test_our_own_frames_reflected_are_dropped() -> None:
    """A modem that echoes, or a loop of links."""
    codec = station()
    assert codec.decode(codec.encode(HEARTBEAT)) == []
    assert codec.stats.echoes == 1
    assert len(codec.decode(StationCodec(242).encode(HEARTBEAT))) == 1


def test_setup_signing_is_never_handed_on() -> None:
    other = common.MAVLink(None, srcSystem=9, srcComponent=9)
    frame = common.MAVLink_setup_signing_message(241, 190, bytes(range(32)), 0).pack(other)
    codec = station()
    assert codec.decode(frame) == []
    assert codec.stats.refused == {"SETUP_SIGNING": 1}


# ---------------------------------------------------------------- loss


def test_loss_is_counted_per_source() -> None:
    codec = station()
    frames = vehicle_frames(300)
    keep = [f for i, f in enumerate(frames) if i not in (3, 4, 100, 256)]
    codec.decode(b"".join(keep))
    codec.decode(StationCodec(1, 154).encode(HEARTBEAT))
    source = codec.stats.sources[1, 1]
    assert source.lost == 4
    assert source.lost / (source.lost + source.received) == pytest.approx(4 / 300)
    assert codec.stats.sources[1, 154] == SourceStats(received=1, lost=0, late=0, last_sequence=0)


def test_frames_out_of_order_are_not_lost() -> None:
    frames = vehicle_frames(6)
    codec = station()
    codec.decode(b"".join(frames[i] for i in (0, 1, 3, 2, 4, 5, 5)))
    source = codec.stats.sources[1, 1]
    assert (source.lost, source.late, source.received) == (0, 2, 7)


# ---------------------------------------------------------------- fuzz


@given(st.lists(st.binary(max_size=300), max_size=8), st.booleans())
def test_any_bytes_at_all(pieces: list[bytes], stream: bool) -> None:
    """Never raises, never remembers more than one unfinished frame, and still reads what comes next."""
    codec = station(stream=stream)
    for piece in pieces:
        codec.decode(piece)
    assert len(codec._pending) < 300
    # 300 bytes of nothing end whatever was unfinished.
    codec.decode(bytes(300))
    assert numbers(codec.decode(vehicle_frames(1)[0])) == [0]


@given(st.integers(0, 2**32), st.booleans())
def test_damaged_real_traffic(seed: int, stream: bool) -> None:
    """Frames cut, flipped, doubled and shuffled with noise: what is handed on is always one of those sent."""
    rng = random.Random(seed)
    frames = vehicle_frames(20)
    data = bytearray()
    for frame in frames:
        piece = bytearray(frame)
        action = rng.random()
        if action < 0.2:
            piece = piece[: rng.randrange(len(piece))]
        elif action < 0.4:
            piece[rng.randrange(len(piece))] ^= 1 << rng.randrange(8)
        elif action < 0.5:
            piece += bytes(rng.randrange(256) for _ in range(rng.randrange(40)))
        elif action < 0.6:
            piece += bytes(piece)
        data += piece
    codec = station(stream=stream)
    step = rng.randrange(1, 400)
    got = [m for i in range(0, len(data), step) for m in codec.decode(bytes(data[i : i + step]))]
    for message in got:
        if message.get_type() == "ATTITUDE":
            assert bytes(message.get_msgbuf()) in frames


@pytest.mark.parametrize("kind", sorted(mavlink.mavlink_map), ids=lambda i: mavlink.mavlink_map[i].msgname)
def test_every_message_of_the_dialect_there_and_back(kind: int) -> None:
    """With every byte of the payload set, as a vehicle may send it."""
    if kind == 256:
        return
    cls = mavlink.mavlink_map[kind]
    payload = bytes((7 * i + 1) % 251 for i in range(cls.unpacker.size))
    header = bytes([0xFD, len(payload), 0, 0, 5, 1, 1, kind & 255, kind >> 8 & 255, kind >> 16])
    crc = mavlink.x25crc(header[1:] + payload + bytes([cls.crc_extra])).crc
    (got,) = station().decode(header + payload + crc.to_bytes(2, "little"))
    assert got.get_msgId() == kind
    assert got.get_type() == cls.msgname


# ---------------------------------------------------------------- parameters

INT32, REAL32, INT8, UINT8, UINT16, UINT32 = 6, 9, 2, 1, 3, 5
INT64 = 8


def from_vehicle(bits: bytes, kind: int, name: bytes = b"COM_OBL_RC_ACT") -> Any:
    """A PARAM_VALUE whose value is these four bytes, through the wire."""
    payload = bits + (900).to_bytes(2, "little") + (17).to_bytes(2, "little") + name.ljust(16, b"\0") + bytes([kind])
    header = bytes([0xFD, len(payload), 0, 0, 0, 1, 1, 22, 0, 0])
    crc = mavlink.x25crc(header[1:] + payload + bytes([220])).crc
    (got,) = station().decode(header + payload + crc.to_bytes(2, "little"))
    return got


@pytest.mark.parametrize(
    ("kind", "value", "bits"),
    [
        (INT32, 3, b"\x03\x00\x00\x00"),
        (INT32, -1, b"\xff\xff\xff\xff"),  # a NaN to whoever reads it as a number
        (INT32, -5_000_000, (-5_000_000).to_bytes(4, "little", signed=True)),  # a signalling one
        (INT32, 2_139_095_041, (2_139_095_041).to_bytes(4, "little")),
        (UINT32, 0xFFFFFFFF, b"\xff\xff\xff\xff"),
        (INT8, -2, b"\xfe\x00\x00\x00"),
        (UINT16, 65535, b"\xff\xff\x00\x00"),
        (REAL32, 1.5, b"\x00\x00\xc0\x3f"),
    ],
)
def test_px4_values_are_bits(kind: int, value: float, bits: bytes) -> None:
    got = read_parameter(from_vehicle(bits, kind), "bytewise")
    assert got == Parameter("COM_OBL_RC_ACT", value, kind, 17, 900)
    assert isinstance(got.value, float if kind == REAL32 else int)


def test_ardupilot_values_are_numbers() -> None:
    five = b"\x00\x00\xa0\x40"
    assert read_parameter(from_vehicle(five, INT8), "c_cast").value == 5
    assert read_parameter(from_vehicle(five, REAL32), "c_cast").value == 5.0
    with pytest.raises(ValueError, match=r"1.5, but its type INT32 is an integer"):
        read_parameter(from_vehicle(b"\x00\x00\xc0\x3f", INT32), "c_cast")
    with pytest.raises(ValueError, match="nan"):
        read_parameter(from_vehicle(b"\xff\xff\xff\xff", INT32), "c_cast")
    with pytest.raises(ValueError, match="type 8"):
        read_parameter(from_vehicle(five, INT64), "c_cast")


def test_sixteen_characters_need_no_terminator() -> None:
    assert read_parameter(from_vehicle(bytes(4), INT32, b"ABCDEFGHIJKLMNOP"), "bytewise").name == "ABCDEFGHIJKLMNOP"


@given(
    st.sampled_from([(INT32, -(2**31), 2**31 - 1), (UINT32, 0, 2**32 - 1), (INT8, -128, 127), (UINT8, 0, 255)]),
    st.data(),
    st.sampled_from(["bytewise", "c_cast"]),
)
def test_what_is_set_is_what_is_read_back(bounds: tuple[int, int, int], data: Any, encoding: Encoding) -> None:
    """Every value either arrives exactly or is refused."""
    kind, low, high = bounds
    value = data.draw(st.integers(low, high))
    try:
        message = write_parameter("X", value, kind, encoding, target_system=1)
    except ParameterError:
        message = None
    if message is None:
        # Only what a float32 cannot carry; the cases by hand are below.
        assert abs(value) > 4_194_304
        return
    (sent,) = StationCodec(1, 1).decode(station().encode(message))
    bits = bytes(sent.get_msgbuf())[10:14]
    assert read_parameter(from_vehicle(bits, kind), encoding).value == value
    assert (sent.param_id, sent.param_type, sent.target_system) == ("X", kind, 1)


@pytest.mark.parametrize(
    ("name", "value", "kind", "encoding", "problem"),
    [
        ("COM_OF_LOSS_T", float("nan"), REAL32, "bytewise", "finite"),  # PX4 would take it
        ("COM_OF_LOSS_T", float("inf"), REAL32, "bytewise", "finite"),
        ("COM_OF_LOSS_T", 1e39, REAL32, "bytewise", "beyond float32"),
        ("NAV_DLL_ACT", 1.5, INT32, "bytewise", "whole numbers"),
        ("NAV_DLL_ACT", 2**31, INT32, "bytewise", "does not fit INT32"),
        ("X", 128, INT8, "c_cast", "does not fit INT8"),
        ("X", 16_777_217, INT32, "c_cast", "float32"),
        ("X", -5_000_000, INT32, "bytewise", "signalling NaN"),
        ("X", 1, INT64, "bytewise", "type 8 cannot be set"),
        ("", 1.0, REAL32, "bytewise", "1 to 16 ASCII"),
        ("A" * 17, 1.0, REAL32, "bytewise", "1 to 16 ASCII"),
        ("HÖHE", 1.0, REAL32, "bytewise", "1 to 16 ASCII"),
    ],
)
def test_values_that_cannot_be_carried_are_refused(
    name: str, value: float, kind: int, encoding: Encoding, problem: str
) -> None:
    with pytest.raises(ValueError, match=problem):
        write_parameter(name, value, kind, encoding, target_system=1)


def test_the_vehicle_says_how_it_writes_integers() -> None:
    assert encoding_of(mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE, "c_cast") == "bytewise"
    assert encoding_of(mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_C_CAST, "bytewise") == "c_cast"
    assert encoding_of(0, "bytewise") == "bytewise"


def test_stats_are_plain_data() -> None:
    codec = station()
    codec.decode(vehicle_frames(1)[0])
    assert dataclasses.asdict(codec.stats)["received"] == 1


@pytest.mark.parametrize("size", [44, 50, 57, 64, 100])
def test_frames_cut_at_the_borders_of_datagrams_are_put_together(size: int) -> None:
    """A serial bridge that fills its datagrams cuts frames anywhere: none is lost, and none counts as damage."""
    codec, stream = station(), b"".join(vehicle_frames(40))
    pieces = [stream[k : k + size] for k in range(0, len(stream), size)]
    told = [number for piece in pieces for number in numbers(codec.decode(piece))]
    assert told == list(range(40))
    assert (codec.stats.garbage_bytes, codec.stats.bad_frames) == (0, 0)


def test_a_cut_frame_whose_rest_never_comes_swallows_nothing() -> None:
    codec = station()
    first, second, third = vehicle_frames(3)
    assert codec.decode(first[:15]) == []
    assert numbers(codec.decode(second)) == [1]
    assert codec.stats.garbage_bytes == 15
    assert numbers(codec.decode(third)) == [2]
    assert codec.stats.bad_frames == 0
