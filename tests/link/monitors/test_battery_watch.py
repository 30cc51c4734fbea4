"""What `BatteryWatch` says of one figure after another: at its levels, to the per cent and the step."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from link.monitors.battery import BatteryWatch
from link.telemetry.vehicle_monitor import Battery


class Bench:
    """A watch, and what it raised."""

    def __init__(self) -> None:
        self.told: list[tuple[str, dict[str, Any]]] = []
        self.timeline = SimpleNamespace(now_s=0.0, alarm=lambda what, **data: self.told.append((what, data)))
        self.monitor = SimpleNamespace(battery_percent=None, batteries={})
        vehicle = SimpleNamespace(monitor=self.monitor)
        self.watch = BatteryWatch(self.timeline, vehicle)  # type: ignore[arg-type]

    def tell(self, percent: int | None, time_s: float = 0.0, left_s: float | None = None) -> list[str]:
        """The vehicle says so much; what is raised."""
        before = len(self.told)
        self.timeline.now_s, self.monitor.battery_percent = time_s, percent
        self.watch.update(left_s)
        return [what for what, _ in self.told[before:]]


def test_a_level_is_told_once_when_the_charge_is_below_it() -> None:
    bench = Bench()
    assert [bench.tell(p) for p in (None, 100, 21, 20)] == [[], [], [], []]
    assert bench.tell(19) == ["battery low"]
    assert bench.told[-1][1] == {"percent": 19}
    assert [bench.tell(p) for p in (18, 19, 11, 10)] == [[], [], [], []]
    assert bench.tell(9) == ["battery critical"]
    assert [bench.tell(p) for p in (8, 15, 9, 0)] == [[], [], [], []]


def test_below_both_levels_at_once_only_the_worse_is_told() -> None:
    bench = Bench()
    assert bench.tell(5) == ["battery critical"]
    assert bench.tell(4) == []


def test_the_end_is_foretold_from_the_fourth_step_on_and_again_when_it_is_three_per_cent_worse() -> None:
    bench = Bench()
    # A per cent in ten seconds, 700 s to go: 73 - 70 = 3 left at the end.
    assert [bench.tell(p, t, 700.0) for p, t in ((76, 0.0), (75, 10.0), (75, 15.0), (74, 20.0))] == [[], [], [], []]
    assert bench.tell(73, 30.0, 700.0) == ["the battery will not last"]
    assert bench.told[-1][1] == {"percent": 73, "at_end_percent": 3.0, "left_s": 700.0}
    assert bench.tell(72, 40.0, 720.0) == []  # 0 left: no more than three worse
    assert bench.tell(71, 50.0, 711.0) == ["the battery will not last"]  # -0.1
    assert bench.told[-1][1]["at_end_percent"] == -0.1


def test_a_reserve_of_ten_per_cent_is_enough() -> None:
    for left_s, told in ((630.0, []), (631.0, ["the battery will not last"])):
        bench = Bench()
        for percent, time_s in ((76, 0.0), (75, 10.0), (74, 20.0)):
            bench.tell(percent, time_s, left_s)
        assert bench.tell(73, 30.0, left_s) == told


def test_off_the_plan_nothing_is_foretold_but_the_steps_count() -> None:
    bench = Bench()
    for percent, time_s in ((76, 0.0), (75, 10.0), (74, 20.0), (73, 30.0)):
        assert bench.tell(percent, time_s, None) == []
    assert bench.tell(72, 40.0, 700.0) == ["the battery will not last"]


def test_another_battery_begins_anew() -> None:
    bench = Bench()
    for percent, time_s in ((76, 0.0), (75, 10.0), (74, 20.0)):
        bench.tell(percent, time_s, 900.0)
    for percent, time_s in ((90, 30.0), (89, 31.0), (88, 32.0)):
        assert bench.tell(percent, time_s, 900.0) == []
    assert bench.tell(87, 33.0, 900.0) == ["the battery will not last"]
    assert bench.told[-1][1]["at_end_percent"] == pytest.approx(87.0 - 900.0)


def test_the_rate_is_that_of_the_newest_ten_steps() -> None:
    """A hard climb at the beginning is not held against the cruise for ever."""
    bench = Bench()
    percent, time_s = 100, 0.0
    for _ in range(5):
        bench.tell(percent, time_s, None)
        percent, time_s = percent - 1, time_s + 0.1
    for _ in range(10):
        bench.tell(percent, time_s, None)
        percent, time_s = percent - 1, time_s + 10.0
    # 85 % left; the eleven newest steps are all of the slow rate: 850 s to go leave nothing.
    assert bench.tell(percent, time_s, 850.0) == ["the battery will not last"]
    assert bench.told[-1][1]["at_end_percent"] == pytest.approx(0.0)


@pytest.mark.parametrize(
    ("number", "percent", "state", "told"),
    [
        (0, 80, 0, []),
        (0, 4, 1, []),  # SYS_STATUS has the first one's figure
        (0, 80, 3, ["battery 0 is critical"]),
        (1, 20, 1, []),
        (1, 19, 1, ["battery 1 is low"]),
        (1, 10, 0, ["battery 1 is low"]),
        (1, 9, 0, ["battery 1 is critical"]),
        (1, 4, 4, ["battery 1 is an emergency"]),
        (2, None, 5, ["battery 2 is failed"]),
        (2, None, 6, ["battery 2 is unhealthy"]),
        (2, None, 7, []),  # charging
    ],
)
def test_every_battery_is_told_by_its_own_words(number: int, percent: int | None, state: int, told: list[str]) -> None:
    bench = Bench()
    bench.monitor.batteries[number] = Battery(0.0, percent, state)
    assert bench.tell(90) == told
    assert bench.tell(90) == []
    if told:
        assert bench.told[-1][1] == {"battery": number, "percent": percent}


def test_a_battery_that_gets_worse_is_told_again_and_one_that_recovers_is_not() -> None:
    bench = Bench()
    found = []
    for state in (2, 3, 2, 3, 4):
        bench.monitor.batteries[1] = Battery(0.0, 50, state)
        found.append(bench.tell(90))
    assert found == [["battery 1 is low"], ["battery 1 is critical"], [], [], ["battery 1 is an emergency"]]
