"""Link URLs: the grammar of `udpout:HOST:PORT`, `udpin:`, `tcp:` and `serial:`."""

from __future__ import annotations

import ipaddress
import re
from dataclasses import dataclass

from link.errors import EndpointUrlError

_SCHEMES = ("udpout", "udpin", "tcp", "serial")
_BAUD_RATES = (1200, 4_000_000)


@dataclass(frozen=True)
class LinkUrl:
    """A parsed link URL: scheme, host and port, or device and baud rate."""

    scheme: str
    host: str
    number: int
    """Port, or baud rate for ``serial``."""

    @property
    def is_stream(self) -> bool:
        """Whether its bytes come without bounds between frames, so that a frame may arrive in pieces."""
        return self.scheme in ("tcp", "serial")

    def __str__(self) -> str:
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{self.scheme}:{host}:{self.number}"


def parse_url(url: str) -> LinkUrl:
    """Take a link URL apart.

    Port 0 is allowed for ``udpin`` alone (any free port). Raises `EndpointUrlError` with the part that is wrong.
    """
    scheme, colon, rest = url.strip().partition(":")
    if scheme not in _SCHEMES or not colon:
        raise EndpointUrlError(url, f"unknown kind {scheme!r}")
    match = re.fullmatch(r"(?:\[(?P<v6>[^\]]*)\]|(?P<host>.*)):(?P<number>[^:]*)", rest)
    what = "device and baud rate" if scheme == "serial" else "host and port"
    if match is None:
        raise EndpointUrlError(url, f"{what} are missing")
    host = match["v6"] if match["v6"] is not None else match["host"]
    if not host:
        raise EndpointUrlError(url, f"the {what.split(' ', 1)[0]} is empty")
    if scheme != "serial":
        if match["v6"] is not None:
            try:
                ipaddress.IPv6Address(host.partition("%")[0])
            except ValueError:
                raise EndpointUrlError(url, f"{host!r} is not an IPv6 address") from None
        elif ":" in host:
            raise EndpointUrlError(url, f"write an IPv6 address in brackets, as in {scheme}:[{host}]:{match['number']}")
        elif "/" in host or re.search(r"\s", host):
            raise EndpointUrlError(url, f"{host!r} is not a host name or address")
    if not re.fullmatch(r"[0-9]{1,9}", match["number"]):
        raise EndpointUrlError(url, f"{match['number']!r} is not a number")
    number = int(match["number"])
    low, high = _BAUD_RATES if scheme == "serial" else (0 if scheme == "udpin" else 1, 65535)
    if not low <= number <= high:
        name = "baud rate" if scheme == "serial" else "port"
        raise EndpointUrlError(url, f"{name} {number} is out of range, allowed is {low} to {high}")
    return LinkUrl(scheme, host, number)


def is_local(url: str) -> bool:
    """Whether a link's URL names this machine itself. Raises `EndpointUrlError`."""
    parsed = parse_url(url)
    if parsed.scheme == "serial":
        return False
    if parsed.host == "localhost":
        return True
    try:
        return ipaddress.ip_address(parsed.host.partition("%")[0]).is_loopback
    except ValueError:
        return False
