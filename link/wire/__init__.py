"""Bytes and messages: codec, signing, the timestamps signing keeps."""

from link.wire.codec import StationCodec
from link.wire.signing import Signing, SigningKey
from link.wire.signing_timestamps import SigningStore

__all__ = ["Signing", "SigningKey", "SigningStore", "StationCodec"]
