"""Each message of the vehicle once in a log, however many links brought it.

An autopilot counts its frames on every link for itself, so one message comes in frames that differ in number and
checksum: the same are those of one source, kind and payload. The same over one link again is another message.
"""

from __future__ import annotations

from collections import OrderedDict

from link.dialect import mavlink

WITHIN_S = 1.0
"""Links are apart by so much at most. An unstamped message (HEARTBEAT) may come again with the same payload, so it must
not be longer than what those take from one to the next."""
WITHIN_STAMPED_S = 10.0
"""The same for messages that carry the vehicle's clock: no two of them are alike."""
_MOST = 20_000


class KeptOnce:
    """Which frames of the vehicle ``system_id`` are news. Times are the flight's clock, seconds."""

    def __init__(self, system_id: int) -> None:
        self._system_id = system_id
        self._kept: OrderedDict[bytes, list[tuple[float, set[str]]]] = OrderedDict()

    def fresh(self, now_s: float, url: str, frame: bytes) -> bool:
        """Whether this frame, heard over the link ``url``, holds a message that no other link has brought yet."""
        v2 = frame[0] == mavlink.PROTOCOL_MARKER_V2
        if frame[5 if v2 else 3] != self._system_id:
            return True
        body = frame[5 : 10 + frame[1]] if v2 else frame[3 : 6 + frame[1]]
        kind = int.from_bytes(frame[7:10], "little") if v2 else frame[5]
        message = mavlink.mavlink_map.get(kind)
        fields = () if message is None else message.fieldnames
        within_s = WITHIN_STAMPED_S if "time_boot_ms" in fields or "time_usec" in fields else WITHIN_S
        kept = [one for one in self._kept.pop(body, []) if now_s - one[0] <= within_s]
        waiting = next((links for _, links in kept if url not in links), None)
        if waiting is None:
            kept.append((now_s, {url}))
        else:
            waiting.add(url)
        self._kept[body] = kept
        while len(self._kept) > _MOST:
            self._kept.popitem(last=False)
        return waiting is None
