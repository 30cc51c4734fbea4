"""Byte pipes, and the gate every frame leaves by."""

from link.transport.gate import Sender
from link.transport.port_lock import LinkLocks
from link.transport.url import LinkUrl, is_local, parse_url

__all__ = ["LinkLocks", "LinkUrl", "Sender", "is_local", "parse_url"]
