"""MAVLink 2 signing as the recorded autopilot does it.

- Each link's stamp starts exactly 60 s ahead of the one given at set-up and moves by one a frame, or up to what the
  link accepted last.
- Link 0 (the first serial link) takes anything, signed or not, with any key. On the others a frame that is unsigned,
  signed with another key, or stamped at or behind its own stream's last stamp is dropped; so is a new stream (system,
  component, link id) stamped more than 60 s behind the vehicle. Every rejection is silent.
- The signature is checked before a stamp is stored, so a forged stamp changes nothing.
"""

from __future__ import annotations

import hashlib
import hmac

from sitl_fixtures.mavlink.wire import Message, is_signed

STAMPS_PER_S = 100_000
AHEAD = 60 * STAMPS_PER_S
LINK_ALWAYS_OPEN = 0


class Signing:
    """Key, stamps and the two checks."""

    def __init__(self) -> None:
        self._key: bytes | None = None
        self._stamps: dict[int, int] = {}
        self._first_stamp = 0
        self._streams: dict[tuple[int, int, int], int] = {}

    @property
    def active(self) -> bool:
        """Whether a key is set: outgoing frames are signed."""
        return self._key is not None

    def set_up(self, key: bytes, timestamp: int) -> None:
        """Takes a key; 32 zero bytes with stamp 0 turn signing off."""
        self._streams.clear()
        if not any(key):
            self._key = None
            return
        self._key = key
        self._stamps.clear()
        self._first_stamp = timestamp + AHEAD

    def stamp(self, link: int) -> int:
        """The stamp a link stands at, 10 us units since 2015."""
        return self._stamps.get(link, self._first_stamp)

    def sign(self, frame: bytes, link: int) -> bytes:
        """The 13 bytes after a frame: link id, stamp, 48-bit signature."""
        assert self._key is not None
        stamp = self.stamp(link) + 1
        self._stamps[link] = stamp
        tail = bytes((link & 0xFF,)) + stamp.to_bytes(6, "little")
        return tail + hashlib.sha256(self._key + frame + tail).digest()[:6]

    def admits(self, link: int, message: Message) -> bool:
        """Whether a frame that came in on a link is let in; keeps its stamp when it is genuine."""
        if self._key is None:
            return True
        genuine = is_signed(message) and self._genuine(link, message)
        return genuine or link == LINK_ALWAYS_OPEN

    def _genuine(self, link: int, message: Message) -> bool:
        assert self._key is not None
        raw = bytes(message.get_msgbuf())
        if not hmac.compare_digest(hashlib.sha256(self._key + raw[:-6]).digest()[:6], raw[-6:]):
            return False
        stamp = int.from_bytes(raw[-12:-6], "little")
        stream = (message.get_srcSystem(), message.get_srcComponent(), raw[-13])
        last = self._streams.get(stream)
        if last is not None and stamp <= last:
            return False
        if last is None and stamp + AHEAD < self.stamp(link):
            return False
        self._streams[stream] = stamp
        self._stamps[link] = max(self.stamp(link), stamp)
        return True
