"""MAVLink 2 message signing, verified before anything is remembered.

A signed frame ends in 13 bytes: link id, 48-bit time stamp in units of 10 us since 2015-01-01 UTC, and the first 48
bits of SHA-256(key, frame up to and including the stamp) (MAVLink guide, "Message Signing"). A *stream* is one
(link id, system, component); its stamps must rise.

What differs from pymavlink's own checks, each for a fault seen there:

- the hash is compared before the stamp is looked at: a forged frame changes nothing;
- a frame is refused when its signature is wrong, even where unsigned ones are allowed;
- stamps of every stream, our own included, survive a restart: no frame is ever accepted twice;
- our own stamp is the clock's or one more than the last, never behind either; the clock is read once and then
  follows the monotonic clock, so that a jump of the wall clock cannot lock us out.

One shared key proves membership, not which station; nothing is encrypted.
"""

from __future__ import annotations

import base64
import enum
import hashlib
import hmac
import os
import stat
import time
from collections.abc import Callable, Collection
from pathlib import Path
from typing import Any

from link.errors import SigningKeyError
from link.wire.signing_timestamps import SigningStore

UNITS_PER_S = 100_000
EPOCH_UNIX_S = 1_420_070_400.0
"""2015-01-01T00:00:00Z, where stamps start."""
NEW_STREAM_BEHIND_UNITS = 60 * UNITS_PER_S
"""A stream never heard before may be at most this far behind our own stamp."""
MAX_STAMP = (1 << 48) - 1
"""Stamps end in 2104. One taken from near there would leave us none of our own."""
_RESERVED_UNITS = 86_400 * UNITS_PER_S

_SIGNED_FLAG = 0x01
_MARKER_V2 = 0xFD


class Verdict(enum.Enum):
    """What the rules say about a frame; the value is the word used in statistics."""

    SIGNED = "signed"
    UNSIGNED_ALLOWED = "unsigned, allowed"
    UNSIGNED = "unsigned"
    MAVLINK_1 = "MAVLink 1"
    WRONG_SIGNATURE = "wrong signature"
    REPLAYED = "stamp not newer than the last"
    TOO_OLD = "new stream, stamp too old"
    NO_STAMPS_LEFT = "stamp at the end of its range"
    TOO_MANY_STREAMS = "too many streams"
    SETUP_SIGNING = "SETUP_SIGNING"

    @property
    def accepted(self) -> bool:
        """Whether the frame may be handed on."""
        return self in (Verdict.SIGNED, Verdict.UNSIGNED_ALLOWED)


class SigningKey:
    """A 32-byte secret that never shows itself: not in ``repr``, ``str``, pickles or error messages."""

    __slots__ = ("_secret",)

    def __init__(self, secret: bytes) -> None:
        if len(secret) != 32:
            raise SigningKeyError(f"a signing key has 32 bytes, this one has {len(secret)}")
        if not any(secret):
            raise SigningKeyError("a signing key of zeros means 'signing off' to an autopilot and is refused")
        self._secret = bytes(secret)

    @classmethod
    def from_text(cls, text: str) -> SigningKey:
        """A key written as 64 hexadecimal digits or as base64 of 32 bytes; blanks around it are ignored."""
        word = text.strip()
        try:
            secret = bytes.fromhex(word) if len(word) == 64 else base64.b64decode(word, validate=True)
        except ValueError:
            if len(word) == 64:
                raise SigningKeyError("a key of 64 characters must be hexadecimal") from None
            raise SigningKeyError("a key is 64 hexadecimal digits or the base64 of 32 bytes") from None
        return cls(secret)

    @classmethod
    def from_passphrase(cls, passphrase: str) -> SigningKey:
        """The SHA-256 of the words, as other ground stations derive it."""
        if not passphrase:
            raise SigningKeyError("an empty passphrase is no key")
        return cls(hashlib.sha256(passphrase.encode()).digest())

    @classmethod
    def from_file(cls, path: str | Path) -> SigningKey:
        """A key file: 32 raw bytes, or text as in `from_text`. Refused when others on the machine can read it."""
        path = Path(path)
        try:
            mode = path.stat().st_mode
            content = path.read_bytes()
        except OSError as error:
            raise SigningKeyError(f"key file {path}: {error.strerror}") from None
        if mode & (stat.S_IRWXG | stat.S_IRWXO):
            raise SigningKeyError(f"key file {path} is open to others (mode {mode & 0o777:o}): chmod 600 it")
        try:
            return cls(content) if len(content) == 32 else cls.from_text(content.decode("ascii"))
        except UnicodeDecodeError:
            raise SigningKeyError(
                f"key file {path} holds {len(content)} bytes that are neither a key nor text"
            ) from None
        except SigningKeyError as error:
            raise SigningKeyError(f"key file {path}: {error}") from None

    @classmethod
    def from_environment(cls, name: str) -> SigningKey:
        """The key in an environment variable, as in `from_text`."""
        value = os.environ.get(name)
        if not value:
            raise SigningKeyError(f"environment variable {name} is not set: put the signing key there")
        try:
            return cls.from_text(value)
        except SigningKeyError as error:
            raise SigningKeyError(f"environment variable {name}: {error}") from None

    def signature(self, signed_part: bytes) -> bytes:
        """The six signature bytes over a frame up to and including its stamp."""
        return hashlib.sha256(self._secret + signed_part).digest()[:6]

    def reveal(self) -> bytes:
        """The secret itself, for the one place that needs it: pymavlink's packer."""
        return self._secret

    def __eq__(self, other: object) -> bool:
        return isinstance(other, SigningKey) and hmac.compare_digest(self._secret, other._secret)

    # Comparable but not hashable: a hash would say something about the secret.
    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        return "SigningKey(hidden)"

    def __reduce__(self) -> Any:
        raise TypeError("a signing key is not pickled; pass the name of its file or variable")


class WallStamp:
    """Stamps from the wall clock as it was at the start, carried on by the monotonic clock."""

    def __init__(self, wall: Callable[[], float] = time.time, monotonic: Callable[[], float] = time.monotonic) -> None:
        self._monotonic = monotonic
        self._offset_s = wall() - EPOCH_UNIX_S - monotonic()

    def __call__(self) -> int:
        """Now, in units of 10 us since 2015; never negative."""
        return max(0, int((self._offset_s + self._monotonic()) * UNITS_PER_S))


class Signing:
    """The signing state of one station: its key, its link id, its stamps and what it takes unsigned.

    ``link_id`` (0..255) must differ between stations that share a system id or key; a station's system id serves.
    ``store`` keeps the stamps (`SigningStore.open` for a file, `SigningStore.in_memory` for tests).
    ``allow_unsigned`` lists message ids taken without a signature, e.g. RADIO_STATUS (109), which a radio modem
    cannot sign. ``now`` gives the present stamp.
    """

    def __init__(
        self,
        key: SigningKey,
        link_id: int,
        store: SigningStore,
        *,
        allow_unsigned: Collection[int] = (),
        now: Callable[[], int] | None = None,
    ) -> None:
        if not 0 <= link_id <= 255:
            raise ValueError(f"link_id is {link_id}, allowed is 0 to 255")
        self.key = key
        self.link_id = link_id
        self.store = store
        self.allow_unsigned = frozenset(allow_unsigned)
        self._now = now if now is not None else WallStamp()

    @property
    def stamp(self) -> int:
        """The last stamp sent or adopted."""
        return self.store.own_stamp

    def next_stamp(self) -> int:
        """The stamp of the next frame: the clock's, or one more than the last where that is higher. Persisted."""
        stamp = max(self.store.own_stamp + 1, self._now())
        self.store.own_stamp = stamp
        return stamp

    def arm(self, state: Any) -> None:
        """Make a pymavlink signing state sign outgoing frames with this key and link id."""
        state.secret_key = self.key.reveal()
        state.link_id = self.link_id
        state.sign_outgoing = True

    def judge(self, frame: bytes, message_id: int) -> Verdict:
        """Whether a whole frame with a good checksum may be handed on; remembers its stamp only if so."""
        if frame[0] != _MARKER_V2 or not frame[2] & _SIGNED_FLAG:
            if message_id in self.allow_unsigned:
                return Verdict.UNSIGNED_ALLOWED
            return Verdict.UNSIGNED if frame[0] == _MARKER_V2 else Verdict.MAVLINK_1
        if not hmac.compare_digest(self.key.signature(frame[:-6]), frame[-6:]):
            return Verdict.WRONG_SIGNATURE
        # From here on the sender holds the key.
        stamp = int.from_bytes(frame[-12:-6], "little")
        stream = (frame[-13], frame[5], frame[6])
        last = self.store.last_stamp(stream)
        if last is not None:
            if stamp <= last:
                return Verdict.REPLAYED
        elif stamp + NEW_STREAM_BEHIND_UNITS < max(self._now(), self.store.own_stamp):
            return Verdict.TOO_OLD
        if stamp > MAX_STAMP - _RESERVED_UNITS:
            return Verdict.NO_STAMPS_LEFT
        if not self.store.remember(stream, stamp):
            return Verdict.TOO_MANY_STREAMS
        # Ours must not fall behind a peer's: it may hold new streams to within a minute of its own stamp.
        if stamp > self.store.own_stamp:
            self.store.own_stamp = stamp
        return Verdict.SIGNED
