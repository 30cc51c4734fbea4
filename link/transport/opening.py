"""From a link URL to an open endpoint."""

from __future__ import annotations

import time
from collections.abc import Callable

from link.transport.endpoint import Endpoint
from link.transport.serial_port import SerialEndpoint
from link.transport.udp_tcp import TcpEndpoint, UdpInEndpoint, UdpOutEndpoint
from link.transport.url import parse_url


def open_endpoint(url: str, *, clock: Callable[[], float] = time.monotonic) -> Endpoint:
    """Open a link by its URL; ``clock`` is the monotonic clock for back-off and peers' silence.

    Raises `EndpointUrlError` for a URL that is not ours, `EndpointError` when the address is unknown, taken or not
    permitted. A TCP peer or serial device that is not there yet is no error: it is tried again with back-off.
    """
    parsed = parse_url(url)
    if parsed.scheme == "serial":
        return SerialEndpoint(parsed, clock)
    if parsed.scheme == "tcp":
        return TcpEndpoint(parsed, clock)
    return UdpInEndpoint(parsed, clock) if parsed.scheme == "udpin" else UdpOutEndpoint(parsed)
