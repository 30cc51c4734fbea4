"""Byte pipes, and the gate every frame leaves by."""

from link.transport.port_lock import LinkLocks
from link.transport.url import LinkUrl, parse_url

__all__ = ["LinkLocks", "LinkUrl", "parse_url"]
