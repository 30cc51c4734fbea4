"""A flight in virtual time whose vehicle's words are changed, lost, or added to on their way down."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

from gcs.flight import FlightState
from link.dialect import mavlink
from link.wire.codec import StationCodec
from tests.support.flights.virtual import VirtualFlight
from tests.support.plans.planned import relay_plan

Tamper = Callable[[float, str, Any], Iterable[Any]]
"""(now, link, message) to the messages that go down instead."""


class TamperedFlight(VirtualFlight):
    """A flight with ``tamper`` between the vehicle and the stations (None: nothing), and `say` for words of its own."""

    def __init__(self, *args: Any, **more: Any) -> None:
        super().__init__(*args, **more)
        self.tamper: Tamper | None = None
        self._voice = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
        self._ears = {link: StationCodec(99) for link in self.links}

    def _put(self, link: str, up: bool, data: bytes, holder: str | None) -> None:
        if up or self.tamper is None:
            super()._put(link, up, data, holder)
            return
        for message in self._ears[link].decode(data):
            for changed in self.tamper(self.now_s, link, message):
                # Whole as it came where it was not changed; else framed anew with its own number.
                same = changed is message
                frame = bytes(message.get_msgbuf()) if same else self._frame(changed, message.get_seq())
                super()._put(link, up, frame, holder)

    def _frame(self, message: Any, sequence: int) -> bytes:
        self._voice.seq = sequence
        return bytes(message.pack(self._voice))

    def say(self, message: Any, *, links: Iterable[str] | None = None) -> None:
        """The vehicle's autopilot says this now, over these links (all)."""
        for link in links or self.links:
            self._voice.seq = (self._voice.seq + 1) % 256
            self.core.receive(link.split("/")[0], bytes(message.pack(self._voice)), self.now_s, self._urls[link])

    def alarms(self, what: str = "") -> list[str]:
        """What was told as an alarm so far, those whose words hold ``what``."""
        return [str(e.data["what"]) for e in self.said("alarm") if what in str(e.data["what"])]

    def first_alarm_s(self, what: str, after_s: float = 0.0) -> float:
        """When an alarm was first told after a time; raises `AssertionError` where it was not."""
        found = [e.time_s for e in self.said("alarm") if what in str(e.data["what"]) and e.time_s >= after_s]
        assert found, f"no alarm {what!r} after {after_s:.2f} s; told: {self.alarms()}"
        return found[0]


def without(*kinds: str) -> Tamper:
    """Those kinds do not come down any more."""
    return lambda now_s, link, message: () if message.get_type() in kinds else (message,)


def altered(kind: str, **fields: Any) -> Tamper:
    """Every message of a kind has these values."""

    def change(now_s: float, link: str, message: Any) -> Iterable[Any]:
        if message.get_type() != kind:
            return (message,)
        return (type(message)(*(fields.get(name, getattr(message, name)) for name in message.fieldnames)),)

    return change


def in_the_air(autopilot: str, plan_s: float = 6.0, **request: Any) -> TamperedFlight:
    """A flight at a time of its plan."""
    one = TamperedFlight(relay_plan(2), autopilot, frugal=True, request=request)
    one.run(until=lambda: one.plan_s >= plan_s, limit_s=300.0)
    assert one.core.state is FlightState.CRUISE
    return one


def ready(autopilot: str, **request: Any) -> TamperedFlight:
    """A flight that has passed its preflight and waits for the launch command."""
    one = TamperedFlight(relay_plan(2), autopilot, frugal=True, request={"auto_launch": False, **request})
    one.run(until=lambda: one.core.state is FlightState.READY, limit_s=120.0)
    assert one.core.state is FlightState.READY
    one.run_for(2.0)
    return one
