"""Bytes to messages and back, one codec per station.

A station owns a system id, a sequence counter and, where used, a signing state. Packing and field decoding are
pymavlink's (the generated dialect); framing, signature policy and statistics are ours, because the stock parser hands
on unknown messages unchecked, stores a signature's time stamp before it has verified it, and swallows up to 280
good bytes after one stray start marker.
"""

from __future__ import annotations

import struct
from collections import deque
from dataclasses import dataclass, field
from typing import Any

from link.dialect import mavlink
from link.errors import SigningError
from link.wire.sequence import frames_ahead
from link.wire.signing import Signing, Verdict

_HEADER_V1, _HEADER_V2, _CHECKSUM, _SIGNATURE = 6, 10, 2, 13
_SETUP_SIGNING = 256


@dataclass
class SourceStats:
    """What one (system, component) sent us: ``received`` messages, ``lost`` by gaps in its sequence numbers,
    ``late`` frames that arrived out of order or twice."""

    received: int = 0
    lost: int = 0
    late: int = 0
    last_sequence: int | None = None

    def count(self, sequence: int) -> None:
        """Account for one frame; a step of 128 or more counts as backwards."""
        self.received += 1
        if self.last_sequence is not None:
            ahead = frames_ahead(self.last_sequence, sequence)
            if ahead <= 0:
                self.late += 1
                self.lost = max(0, self.lost - 1)
                return
            self.lost += ahead - 1
        self.last_sequence = sequence


@dataclass
class CodecStats:
    """Counters of one codec since it was made; ``refused`` counts by the reason in `link.wire.signing.Verdict`."""

    sent: int = 0
    received: int = 0
    bytes_received: int = 0
    garbage_bytes: int = 0
    bad_frames: int = 0
    unknown_messages: int = 0
    echoes: int = 0
    refused: dict[str, int] = field(default_factory=dict)
    sources: dict[tuple[int, int], SourceStats] = field(default_factory=dict)


def frame_length(data: bytes | bytearray, start: int) -> int | None:
    """Length of the frame whose marker is at ``start``, from its header; None while the header is incomplete.

    0 means that no frame can start here: not a marker, flags this protocol version does not know, or a MAVLink 1
    payload longer than its message.
    """
    marker = data[start]
    left = len(data) - start
    if marker == mavlink.PROTOCOL_MARKER_V2:
        if left < _HEADER_V2:
            return None
        flags = data[start + 2]
        if flags & ~mavlink.MAVLINK_IFLAG_SIGNED:
            return 0
        # A payload longer than we know is a newer dialect's: fields are added at the end.
        return _HEADER_V2 + int(data[start + 1]) + _CHECKSUM + (_SIGNATURE if flags else 0)
    if marker == mavlink.PROTOCOL_MARKER_V1:
        if left < _HEADER_V1:
            return None
        known = mavlink.mavlink_map.get(data[start + 5])
        if known is not None and data[start + 1] > known.unpacker.size:
            return 0
        return _HEADER_V1 + int(data[start + 1]) + _CHECKSUM
    return 0


class StationCodec:
    """Encoder and decoder of one station.

    ``system_id`` and ``component_id`` (190 = MAV_COMP_ID_MISSIONPLANNER, a ground station) go into every frame.
    ``signing`` signs what is sent and decides what is taken; None sends unsigned and takes anything.
    ``stream`` keeps an unfinished frame for the next call (TCP, serial). Datagrams are decoded each on its own, so that
    a broken one cannot swallow the next; a frame cut at the end of one is kept, and taken where the next completes it.

    Raises `ValueError` for ids outside 1..255.
    """

    def __init__(
        self, system_id: int, component_id: int = 190, *, signing: Signing | None = None, stream: bool = False
    ) -> None:
        for name, value in (("system_id", system_id), ("component_id", component_id)):
            if not 1 <= value <= 255:
                raise ValueError(f"{name} is {value}, allowed is 1 to 255")
        self.system_id = system_id
        self.component_id = component_id
        self.signing = signing
        self.stream = stream
        self.stats = CodecStats()
        self.returned: deque[bytes] = deque(maxlen=64)
        """Frames under this station's own ids that came in, the latest: ours reflected, or somebody else's."""
        # Two objects: the stock class checks incoming signatures as soon as it holds a key, and does it wrong.
        self._out = mavlink.MAVLink(None, srcSystem=system_id, srcComponent=component_id)
        self._in = mavlink.MAVLink(None)
        self._pending = bytearray()
        if signing is not None:
            signing.arm(self._out.signing)

    @property
    def sequence(self) -> int:
        """Sequence number of the next frame."""
        return int(self._out.seq)

    def encode(self, message: Any) -> bytes:
        """The frame of a dialect message: MAVLink 2, this station's ids, next sequence number, signed if so set.

        Raises `SigningError` for SETUP_SIGNING: its payload is the key, so it never takes this road.
        """
        if message.get_msgId() == _SETUP_SIGNING:
            raise SigningError("SETUP_SIGNING carries the key in the clear and is never sent over a station link")
        if self.signing is not None:
            self._out.signing.timestamp = self.signing.next_stamp()
        frame: bytes = message.pack(self._out)
        self._out.seq = (self._out.seq + 1) % 256
        self.stats.sent += 1
        return frame

    def decode(self, data: bytes) -> list[Any]:
        """The messages in ``data``, in order, each a dialect message; never raises on any input.

        Unknown message ids, damaged frames, SETUP_SIGNING, this station's own frames reflected and whatever the signing
        rules refuse are dropped and counted in ``stats``.
        """
        self.stats.bytes_received += len(data)
        messages: list[Any] = []
        buffer, start = self._joined(data, messages)
        cut: int | None = None
        while start < len(buffer):
            length = frame_length(buffer, start)
            if length is None or (length and start + length > len(buffer)):
                if self.stream:
                    break
                cut, length = start if cut is None else cut, 0
            if length:
                frame = bytes(buffer[start : start + length])
                taken, message = self._open(frame, followed_by=buffer[start + length : start + length + 1])
                if taken:
                    start, cut = start + length, None
                    if message is not None:
                        messages.append(message)
                    continue
            self.stats.garbage_bytes += 1
            start += 1
        if cut is not None:
            # Nothing was found behind it: the rest of this frame may be in the next datagram.
            self.stats.garbage_bytes -= len(buffer) - cut
            start = cut
        self._pending = bytearray(buffer[start:])
        return messages

    def _joined(self, data: bytes, messages: list[Any]) -> tuple[bytearray, int]:
        """What is to be decoded, and from where: with what an earlier call left, where the two make a frame."""
        left, self._pending = self._pending, bytearray()
        joined = left + data
        if self.stream or not left:
            return joined, 0
        length = frame_length(joined, 0)
        if length and length <= len(joined):
            bad = self.stats.bad_frames
            taken, message = self._open(bytes(joined[:length]), followed_by=joined[length : length + 1])
            if taken:
                if message is not None:
                    messages.append(message)
                return joined, length
            self.stats.bad_frames = bad
        self.stats.garbage_bytes += len(left)
        return bytearray(data), 0

    def _open(self, frame: bytes, *, followed_by: bytes | bytearray) -> tuple[bool, Any]:
        """(whether these bytes are one frame, its message if it may be handed on)."""
        v2 = frame[0] == mavlink.PROTOCOL_MARKER_V2
        message_id = frame[7] | frame[8] << 8 | frame[9] << 16 if v2 else frame[5]
        if message_id not in mavlink.mavlink_map:
            # Its checksum cannot be known. Believe the length only where another frame or nothing follows.
            plausible = not followed_by or followed_by[0] in (mavlink.PROTOCOL_MARKER_V1, mavlink.PROTOCOL_MARKER_V2)
            self.stats.unknown_messages += plausible
            return plausible, None
        try:
            message = self._in.decode(bytearray(frame))
        except (mavlink.MAVError, struct.error, ValueError, IndexError):
            self.stats.bad_frames += 1
            return False, None
        system, component, sequence = (frame[5], frame[6], frame[4]) if v2 else (frame[3], frame[4], frame[2])
        if message_id == _SETUP_SIGNING:
            self._refuse(Verdict.SETUP_SIGNING)
            return True, None
        if (system, component) == (self.system_id, self.component_id):
            self.stats.echoes += 1
            self.returned.append(frame)
            return True, None
        if self.signing is not None:
            verdict = self.signing.judge(frame, message_id)
            if not verdict.accepted:
                self._refuse(verdict)
                return True, None
            if verdict is Verdict.SIGNED:
                message._signed, message._link_id = True, frame[-_SIGNATURE]
        self.stats.received += 1
        self.stats.sources.setdefault((system, component), SourceStats()).count(sequence)
        return True, message

    def _refuse(self, verdict: Verdict) -> None:
        self.stats.refused[verdict.value] = self.stats.refused.get(verdict.value, 0) + 1
