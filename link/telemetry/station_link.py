"""A station's link: its paths to the vehicle, and which of them sends."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from link.autopilot.local_frame import EkfOrigin
from link.telemetry.link_path import FAILOVER_S, LinkPath, LinkQuality
from link.telemetry.plausibility import same_origin


class StationLink:
    """A station's paths to the vehicle taken together; see `LinkPath` for the figures."""

    def __init__(self, station_id: str, urls: Sequence[str] = ("",)) -> None:
        self.station_id = station_id
        self.paths = tuple(LinkPath(url) for url in urls)
        self.active = self.paths[0]
        """The path that sends."""
        self.origin: EkfOrigin | None = None
        self.origin_s = -math.inf
        self.origin_told = 0
        """How often in a row the origin was told so: another one than before is believed when told twice."""

    def tell_origin(self, now_s: float, origin: EkfOrigin) -> None:
        """The vehicle told its EKF origin over this link."""
        same = self.origin is not None and same_origin(self.origin, origin)
        self.origin_told = self.origin_told + 1 if same else 1
        self.origin, self.origin_s = origin, now_s

    def forget_origin(self) -> None:
        """The vehicle restarted."""
        self.origin, self.origin_told = None, 0

    @property
    def heard_s(self) -> float:
        """Anything of the vehicle's autopilot, over any path."""
        return max(path.heard_s for path in self.paths)

    @property
    def proven_s(self) -> float:
        """When the latest frame left that was answered over the path that sends."""
        return self.active.proven_s

    @property
    def round_trip_s(self) -> float | None:
        """Of the path that sends."""
        return self.active.round_trip_s

    @property
    def latency_s(self) -> float | None:
        """One way, of the path that sends."""
        return self.active.latency_s

    @property
    def messages(self) -> int:
        """Frames of the autopilot, over all paths."""
        return sum(path.messages for path in self.paths)

    def path(self, url: str | None) -> LinkPath:
        """A path by its URL; the one that sends for None, and for a URL of none."""
        return next((path for path in self.paths if path.url == url), self.active)

    def choose(self, patience_s: float = FAILOVER_S) -> str:
        """Let another path send where its proof is newer by ``patience_s``; the URL it was until then, or empty."""
        best = max(self.paths, key=lambda path: path.proven_s)
        if best is self.active or best.proven_s - self.active.proven_s < patience_s:
            return ""
        before, self.active = self.active, best
        return before.url

    def quality(self, now_s: float) -> LinkQuality | None:
        """Of the path that sends."""
        return self.active.quality(now_s)

    def to_document(self, now_s: float) -> dict[str, Any]:
        """As JSON: the figures of the path that sends, and all paths under ``ways`` where there are several."""
        document = self.active.to_document(now_s)
        if len(self.paths) > 1:
            document["ways"] = [{**c.to_document(now_s), "sends": c is self.active} for c in self.paths]
        return document
