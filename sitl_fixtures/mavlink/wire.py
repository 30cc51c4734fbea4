"""One link's end of the wire: frames in and out of pymavlink's stock dialect.

A message is packed once and framed for each link with that link's own sequence number, so a ground station can count
its losses; where signing is on, the frame is signed as well.

At a speed-up of 75 thousands of frames a second go through here. Most are single frames in a datagram of messages
without arrays, and for those the stock classes are used directly (definition, checksum seed, struct); everything else
takes pymavlink's own parser and packer.
"""

from __future__ import annotations

from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

Message = Any
"""A decoded or fresh message of the stock dialect (the generated classes carry no types)."""

MAGIC, HEADER_BYTES, CHECKSUM_BYTES, SIGNATURE_BYTES, SIGNED = 0xFD, 10, 2, 13, 1


def _plain(kind: Any) -> bool:
    """Whether a message has numbers only, no arrays and no text."""
    return all(length == 1 for length in kind.lengths) and "char" not in kind.fieldtypes


PLAIN: dict[int, Any] = {number: kind for number, kind in mavlink.mavlink_map.items() if _plain(kind)}


def checksum(data: bytes, crc_extra: int) -> int:
    """CRC-16/MCRF4XX of a frame from its length byte on, with the message's CRC_EXTRA."""
    return int(mavlink.x25crc(data + bytes((crc_extra,))).crc)


class Packer:
    """Packs messages of one system and component; the frame made lacks sequence number and checksum."""

    def __init__(self, system_id: int, component_id: int) -> None:
        self._mav = mavlink.MAVLink(None, system_id, component_id)
        self._source = bytes((0, system_id, component_id))

    def pack(self, message: Message) -> bytes:
        """The frame with sequence number 0 and any checksum."""
        kind = PLAIN.get(type(message).id)  # a field of STATUSTEXT is called id too
        if kind is None:
            frame: bytes = message.pack(self._mav)
            return frame
        values = message.__dict__
        return self.pack_raw(kind.id, kind.unpacker.pack(*[values[name] for name in kind.ordered_fieldnames]))

    def pack_raw(self, message_id: int, payload: bytes) -> bytes:
        """The frame of a message given by id and payload."""
        payload = payload.rstrip(b"\0") or b"\0"
        head = bytes((MAGIC, len(payload), 0, 0)) + self._source + message_id.to_bytes(3, "little")
        return head + payload + b"\0\0"


class Port:
    """One link: its parser, its sequence number and what has gone through it.

    Attributes:
        heard: whether anything was ever received.
        received, sent: frames counted.
    """

    def __init__(self, index: int) -> None:
        self.index = index
        self.sequence = 0
        self.received = 0
        self.sent = 0
        self.heard = False
        self._parser = mavlink.MAVLink(None, 0, 0)
        self._parser.robust_parsing = True

    def parse(self, data: bytes) -> list[Message]:
        """Messages in what came in, whole and with a good checksum. Damaged and unknown frames are dropped."""
        self.heard = True
        message = self._single(data)
        if message is not None:
            self.received += 1
            return [message]
        found = self._parser.parse_buffer(data) or []
        messages = [m for m in found if m.get_type() != "BAD_DATA" and not m.get_type().startswith("UNKNOWN")]
        self.received += len(messages)
        return messages

    def _single(self, data: bytes) -> Message | None:
        """The message of a datagram that is one whole frame of a plain message; None for everything else."""
        if len(data) < HEADER_BYTES + CHECKSUM_BYTES or data[0] != MAGIC or self._parser.buf_len():
            return None
        length, flags = data[1], data[2]
        end = HEADER_BYTES + length
        if flags & ~SIGNED or len(data) != end + CHECKSUM_BYTES + (SIGNATURE_BYTES if flags & SIGNED else 0):
            return None
        message_id = data[7] | data[8] << 8 | data[9] << 16
        kind = PLAIN.get(message_id)
        if kind is None or data[end] | data[end + 1] << 8 != checksum(data[1:end], kind.crc_extra):
            return None
        size = kind.unpacker.size
        values = kind.unpacker.unpack(data[HEADER_BYTES:end].ljust(size, b"\0")[:size])
        message = kind(*[values[place] for place in kind.orders])
        message._msgbuf = data
        message._header = mavlink.MAVLink_header(message_id, flags, data[3], length, data[4], data[5], data[6])
        return message

    def frame(self, packed: bytes, crc_extra: int, signer: Any | None = None) -> bytes:
        """A packed message as a frame of this link: next sequence number, checksum, signature where there is a signer.

        ``signer`` has ``sign(frame_without_signature, link_index) -> bytes``.
        """
        flags = b"\x01" if signer is not None else b"\0"
        body = packed[1:2] + flags + b"\0" + bytes((self.sequence,)) + packed[5:-2]
        self.sequence = (self.sequence + 1) & 0xFF
        self.sent += 1
        frame = b"\xfd" + body + checksum(body, crc_extra).to_bytes(2, "little")
        return frame + signer.sign(frame, self.index) if signer is not None else frame


def is_signed(message: Message) -> bool:
    """Whether the frame a message came in carried a signature."""
    return bool(message.get_header().incompat_flags & SIGNED)
