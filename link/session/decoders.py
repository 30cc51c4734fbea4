"""Which stations hear what comes over a link, and what reads it."""

from __future__ import annotations

from collections.abc import Mapping

from link.session.request import FlightRequest
from link.transport.url import parse_url
from link.wire.codec import StationCodec


def sharing_of(request: FlightRequest) -> dict[str, tuple[str, ...]]:
    """The stations of each URL: those that share a link hear the same bytes."""
    urls = request.urls
    return {
        url: tuple(other for other in request.stations if url in urls[other])
        for station in request.stations
        for url in urls[station]
    }


def decoders_of(sharing: Mapping[str, tuple[str, ...]], codecs: Mapping[str, StationCodec]) -> dict[str, StationCodec]:
    """A decoder for each URL, signed as the first of its stations is."""
    decoders = {}
    for url, stations in sharing.items():
        codec = codecs[stations[0]]
        stream = parse_url(url).is_stream
        decoders[url] = StationCodec(codec.system_id, signing=codec.signing, stream=stream)
    return decoders
