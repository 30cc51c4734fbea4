"""The simulator held against recorded conversations of real autopilots.

Each recording's stimuli are replayed in virtual time and the answers laid side by side: the same answers, on the same
link, in the same order, and nothing else, but for the differences listed here with their reason. Times may differ by
``TOLERANCE_S`` unless listed. Flown paths, echoed targets and failsafe times are compared as well.
"""

from __future__ import annotations

import bisect
import math
import re
from functools import cache
from typing import Any

import pytest

from tests.support.paths import RECORDINGS
from tests.support.sitl.replay import KEYS, Replay, compare, read_recording

TOLERANCE_S = 0.35
KINDS = {
    "COMMAND_ACK",
    "STATUSTEXT",
    "PARAM_VALUE",
    "MISSION_REQUEST",
    "MISSION_REQUEST_INT",
    "MISSION_COUNT",
    "MISSION_ACK",
    "MISSION_ITEM_INT",
    "AUTOPILOT_VERSION",
}
NAMES = [
    "ardupilot-bad-setpoints",
    "ardupilot-gcs-failsafe",
    "ardupilot-handover-enforced",
    "ardupilot-handover-range",
    "ardupilot-mission",
    "ardupilot-nominal",
    "ardupilot-signing",
    "ardupilot-stream-loss",
    "ardupilot-two-stations-open",
    "px4-bad-setpoints",
    "px4-nominal",
    "px4-params-mission",
    "px4-stream-loss",
    "px4-two-stations",
]

# (recording, what differs, why)
MISSING = [
    ("ardupilot", r"PARAM EK3_SRC1_POSXY .*", "a sensor default the real one tells at start"),
    ("ardupilot-nominal", r"PARAM FORMAT_VERSION .*", "read by index: the parameter lists differ"),
    ("px4-params-mission", r"PARAM BAT1_R_INTERNAL .*", "read by index: the parameter lists differ"),
    ("px4-nominal", r"ACK 512 2 .*", "the origin asked for in the instant before it was laid"),
    ("px4", r"PARAM (SIH_KDV|COM_OF_LOSS_T) .*", "order within one broadcast"),
    ("px4-nominal", r"TEXT 2 Arming denied: .*", "the first one was late, its log was being opened"),
    ("px4-stream-loss", r"TEXT 2 Failsafe activated", "1 Hz holds OFFBOARD but for the real one's jitter"),
    ("px4-params-mission", r"MISSION_REQUEST_INT 1 to 255", "one repetition more in 3 s"),
    ("px4-bad-setpoints", r"TEXT 6 RTL: .*", "a return of a few hundredths of a second between two streams"),
    ("px4-bad-setpoints", r"TEXT 2 SET_POSITION_TARGET_.*", "one refusal before or after another text"),
]
EXTRA = [
    ("ardupilot-nominal", r"PARAM ACRO_YAW_RATE .*", "read by index: the parameter lists differ"),
    ("ardupilot-handover-range", r"PARAM MAV_OPTIONS 1 .*", "the real one lost a broadcast on link B"),
    ("px4-params-mission", r"PARAM BAT1_V_EMPTY .*", "read by index: the parameter lists differ"),
    ("px4-nominal", r"ACK 512 0 .*", "the origin asked for in the instant before it was laid"),
    (
        "px4",
        r"PARAM (SIH_KDV|COM_RCL_EXCEPT|MPC_XY_VEL_MAX|COM_OF_LOSS_T) .*",
        "broadcasts of changes, merged by the real one",
    ),
    ("px4-nominal", r"TEXT 2 Arming denied: .*", "the first one was late, its log was being opened"),
    ("px4-params-mission", r"MISSION_REQUEST_INT 0 to 255", "one repetition more in 5 s"),
    ("px4-bad-setpoints", r"TEXT 6 RTL: .*", "a return of a few hundredths of a second between two streams"),
    ("px4-bad-setpoints", r"TEXT 2 SET_POSITION_TARGET_.*", "one refusal before or after another text"),
]
LATER = [
    ("ardupilot-nominal", r"TEXT 6 Disarming motors", 5.0, "of 110 s of return and landing"),
    (
        "px4-nominal",
        r"TEXT 6 (Landing detected|Disarmed by landing)|PARAM COM_FLIGHT_UUID .*",
        4.0,
        "of 36 s of landing",
    ),
    ("px4", r"PARAM (COM_RCL_EXCEPT|MPC_XY_VEL_MAX) .*", 0.8, "the first broadcast after boot is late"),
]
MOST_DIFFERENCES = 20


def key_of(entry: dict[str, Any]) -> bytes:
    """The key a recorded frame was signed with: link ids 4 and 7, and for half a second 3, used the wrong one."""
    wrong = entry["signed"]["link_id"] in (4, 7) or 59.9 < entry["t"] < 60.5
    return KEYS["B" if wrong else "A"]


@cache
def replayed(name: str) -> Replay:
    return Replay(read_recording(name), key_of=key_of).run()


def allowed(name: str, words: str, table: list[Any]) -> bool:
    return any(name.startswith(row[0]) and re.fullmatch(row[1], words) for row in table)


def check_answers_order_and_timing(name: str) -> None:
    """The same answers on each link, in order, and in time."""
    recording, replay = read_recording(name), replayed(name)
    for link in replay.links:
        first = min(entry["t"] for entry in recording.sent if entry["link"] == link)
        found = compare(recording, replay, link, KINDS, since_s=min(first, 3.2) if first < 60.0 else first)
        unexplained = [("missing", *m) for m in found.missing if not allowed(name, m[1], MISSING)]
        unexplained += [("extra", *e) for e in found.extra if not allowed(name, e[1], EXTRA)]
        for shift, t, words in found.shifts:
            limit = max([TOLERANCE_S] + [row[2] for row in LATER if allowed(name, words, [row])])
            if abs(shift) > limit:
                unexplained.append((f"shifted {shift:.2f} s", t, words))
        assert not unexplained, unexplained
        assert len(found.missing) + len(found.extra) <= MOST_DIFFERENCES + len(found.shifts) // 20


def test_every_recording_is_replayed() -> None:
    assert {path.name.removesuffix(".jsonl.gz") for path in RECORDINGS.glob("*.gz")} == set(NAMES)


# -- paths ------------------------------------------------------------------------------------------------------------


def path_differences(name: str, start: float, end: float) -> tuple[float, float]:
    """Largest horizontal and vertical distance between the real and the simulated path, m.

    A stall of the recording machine shows as a sample or two up to 3 m along the track.
    """
    recording, replay = read_recording(name), replayed(name)
    times = [sample[0] for sample in replay.path]
    worst = worst_z = 0.0
    for heard in recording.heard:
        if heard.name == "LOCAL_POSITION_NED" and heard.link == "A" and start <= heard.t <= end:
            sample = replay.path[min(len(times) - 1, bisect.bisect(times, heard.t))]
            f = heard.fields
            worst = max(worst, math.hypot(sample[1] - f["x"], sample[2] - f["y"]))
            worst_z = max(worst_z, abs(sample[3] - f["z"]))
    return worst, worst_z


# (recording, from, to, largest horizontal and vertical distance between the paths, m)
PATHS = [
    # take-off by command, a curve at 14 m/s, the return until it descends
    ("ardupilot-nominal", 44.0, 66.0, 0.2, 1.5),
    ("ardupilot-nominal", 66.0, 146.0, 3.0, 0.3),
    ("ardupilot-nominal", 146.0, 197.0, 40.0, 1.0),
    # take-off by set-points, a curve at 10.5 m/s
    ("px4-nominal", 11.0, 28.0, 1.2, 3.5),
    ("px4-nominal", 28.4, 94.0, 2.5, 0.8),
    # a swap of stations in flight, an overlap, a pause
    ("ardupilot-handover-enforced", 80.0, 150.0, 3.0, 0.5),
    ("ardupilot-handover-range", 69.5, 149.0, 2.5, 0.5),
    ("px4-two-stations", 48.5, 102.0, 2.5, 0.8),
    # pauses of 0.5, 1 and 2 s with and without acceleration; then the stream stops for good and it flies back
    ("ardupilot-stream-loss", 65.5, 125.0, 3.6, 0.3),
    ("ardupilot-stream-loss", 134.0, 200.0, 3.0, 0.3),
    ("ardupilot-stream-loss", 202.0, 234.0, 4.0, 0.3),
    ("ardupilot-stream-loss", 268.0, 298.0, 4.0, 0.3),
]


def check_flies_where_the_real_one_flew(name: str) -> None:
    """The flown paths agree."""
    for recording, start, end, horizontal_m, vertical_m in PATHS:
        if recording == name:
            worst, worst_z = path_differences(name, start, end)
            assert worst <= horizontal_m, (start, end)
            assert worst_z <= vertical_m, (start, end)


def after_stop(name: str, mark: str, table: str) -> list[tuple[float, float, float, float, float]]:
    """(seconds, real and simulated speed, real and simulated distance) after a stream stopped."""
    recording, replay = read_recording(name), replayed(name)
    stop = recording.mark(mark)
    base = replay.at(stop)
    rows = []
    for seconds, speed, distance in recording.header["observed"][f"{table}: [s, m/s, m from the stop]"]:
        sample = replay.at(stop + seconds)
        ours = math.hypot(sample[1] - base[1], sample[2] - base[2])
        rows.append((seconds, speed, math.hypot(sample[4], sample[5]), distance, ours))
    return rows


def check_ardupilot_runs_on_brakes_and_flies_back(name: str) -> None:
    """3 s on at 15 m/s (44 m), brakes to about 70 m, back to about 43 m: the whole run-out, second by second."""
    if name != "ardupilot-stream-loss":
        return
    for table in ("stop pos+vel+acc", "stop pos+vel"):
        check_run_out(table)


def check_run_out(table: str) -> None:
    rows = after_stop("ardupilot-stream-loss", f"{table}: stream stops", table)
    for seconds, real_speed, our_speed, real_m, our_m in rows:
        assert our_m == pytest.approx(real_m, abs=3.0), seconds
        assert our_speed == pytest.approx(real_speed, abs=2.0), seconds
    assert max(row[4] for row in rows) == pytest.approx(max(row[3] for row in rows), abs=2.0)
    assert rows[-1][4] == pytest.approx(rows[-1][3], abs=2.0)


STOPS = ["stop, COM_OBL_RC_ACT as delivered", "stop, COM_OBL_RC_ACT=5 (Hold)", "stop, COM_OBL_RC_ACT=3 (Return)"]


def check_px4_is_pulled_back_at_once(name: str) -> None:
    """No run-on: 11 m/s fall to 7 within the first second, before any failsafe."""
    if name == "px4-stream-loss":
        for leg in STOPS:
            check_stop(leg)


def check_stop(leg: str) -> None:
    recording, replay = read_recording("px4-stream-loss"), replayed("px4-stream-loss")
    stop = next(t for t, words in recording.header["marks"] if words.startswith(leg) and words.endswith("stream stops"))
    name = next(k for k in recording.header["observed"] if k.startswith(leg) and k.endswith("[s, m/s, m]"))
    base = replay.at(stop)
    for seconds, speed, distance in recording.header["observed"][name]:
        sample = replay.at(stop + seconds)
        assert math.hypot(sample[1] - base[1], sample[2] - base[2]) == pytest.approx(distance, abs=3.0), seconds
        assert math.hypot(sample[4], sample[5]) == pytest.approx(speed, abs=2.5), seconds


# -- echoes and modes -------------------------------------------------------------------------------------------------


def echo(heard: list[Any], start: float, end: float) -> dict[str, Any] | None:
    """The last POSITION_TARGET_LOCAL_NED on link A in a span."""
    found = [h for h in heard if h.name == "POSITION_TARGET_LOCAL_NED" and h.link == "A" and start <= h.t <= end]
    return found[-1].fields if found else None


def shown(value: Any) -> float | None:
    """A number of an echo; None for NaN."""
    if value is None or value != value:
        return None
    return float(value)


def check_what_is_made_of_every_odd_setpoint(name: str) -> None:
    """The mask and the target echoed 0.95 s after each of 98 odd set-points are the real ones."""
    if not name.endswith("bad-setpoints"):
        return
    recording, replay = read_recording(name), replayed(name)
    cases = [(t, w) for t, w in recording.header["marks"] if w.split(": ")[0] in ("hover", "motion", "NaN")]
    assert len(cases) >= 38
    for t, words in cases:
        real, ours = echo(recording.heard, t, t + 0.95), echo(replay.heard, t, t + 0.95)
        assert real is not None, words
        assert ours is not None, words
        assert ours["type_mask"] == real["type_mask"], words
        if re.search(r"frame [789] ", words):
            continue  # relative to where the vehicle was and looked, which differs a little
        for axis in "xyz":
            a, b = shown(real[axis]), shown(ours[axis])
            assert (a is None) == (b is None), words
            if a is not None and b is not None and math.isfinite(a):
                # PX4's home altitude wanders, and relative targets with it.
                margin = 3.5 if axis == "z" and re.search(r"frame (6|11) ", words) else 1.0
                assert b == pytest.approx(a, abs=margin, rel=1e-6), words


def real_modes(name: str) -> list[tuple[float, int]]:
    """Changes of custom_mode in the recorded heartbeats of link A."""
    changes: list[tuple[float, int]] = []
    for h in read_recording(name).heard:
        if (
            h.name == "HEARTBEAT"
            and h.link == "A"
            and h.fields["type"] == 2
            and (not changes or changes[-1][1] != h.fields["custom_mode"])
        ):
            changes.append((h.t, h.fields["custom_mode"]))
    return changes


def check_modes_change_as_the_real_ones(name: str) -> None:
    """Every mode the real heartbeats showed, in order, and within a heartbeat of the same time.

    Where returns last 0.2 s, they fall between two heartbeats of one vehicle and not of the other.
    """
    if name in ("px4-bad-setpoints", "px4-stream-loss"):
        return
    ours: list[tuple[float, int]] = []
    for h in replayed(name).heard:
        if h.name == "HEARTBEAT" and h.link == "A" and (not ours or ours[-1][1] != h.fields["custom_mode"]):
            ours.append((h.t, h.fields["custom_mode"]))
    real = real_modes(name)
    assert [m for _, m in ours] == [m for _, m in real]
    for (a, mode), (b, _) in zip(real, ours, strict=True):
        limit = 5.5 if name == "px4-nominal" and mode == 393216 else 1.2
        assert b == pytest.approx(a, abs=limit), mode


def check_px4_offboard_is_left_and_taken_up_again(name: str) -> None:
    """The vehicle's own modes over the four stops: RTL, HOLD, HOLD that stays until commanded, RTL."""
    if name != "px4-stream-loss":
        return
    modes = [(round(t, 1), mode) for t, mode in replayed("px4-stream-loss").modes]
    # The pause of 1.3 s, and the four stops.
    left_for = ["HOLD", "RTL", "RTL", "HOLD", "HOLD", "RTL"]
    assert [mode for _, mode in modes] == [mode for left in left_for for mode in (left, "OFFBOARD")]
    recording = read_recording("px4-stream-loss")
    commanded = recording.mark("stop, Hold, operator commands HOLD before the stream resumes: OFFBOARD commanded")
    assert any(abs(t - commanded) < 0.2 and mode == "OFFBOARD" for t, mode in modes)


# (recording, mark, link, height of B's targets)
TAKEOVERS = [
    ("ardupilot-two-stations-open", "swap in flight without any ceremony", "B", -63.0),
    ("ardupilot-handover-enforced", "PARAM_SET MAV_GCS_SYSID=254 by A, in flight", "B", -63.0),
    ("ardupilot-handover-enforced", "PARAM_SET MAV_GCS_SYSID=254 by A", "B", -60.0),
]


def check_the_new_owner_is_obeyed_at_once(name: str) -> None:
    """B streams 3 m off the curve; its first target is obeyed within 0.1 s of being the owner and sending."""
    for recording, mark, link, height_m in TAKEOVERS:
        if recording == name:
            check_takeover(name, mark, link, height_m)


def check_takeover(name: str, mark: str, link: str, height_m: float) -> None:
    recording, replay = read_recording(name), replayed(name)
    start = next(t for t, words in recording.header["marks"] if words == mark)
    sent = [
        e["t"]
        for e in recording.sent
        if e["link"] == link
        and e["t"] >= start
        and e["msg"].startswith("SET_POSITION")
        and abs(e["fields"]["z"] - height_m) < 0.5
    ]
    obeyed = [n for n, _, system, *_ in replay.sim.accepted_setpoints if system == 254 and n >= start]
    assert obeyed[0] - sent[0] < 0.1


CHECKS = [
    check_answers_order_and_timing,
    check_flies_where_the_real_one_flew,
    check_ardupilot_runs_on_brakes_and_flies_back,
    check_px4_is_pulled_back_at_once,
    check_what_is_made_of_every_odd_setpoint,
    check_modes_change_as_the_real_ones,
    check_px4_offboard_is_left_and_taken_up_again,
    check_the_new_owner_is_obeyed_at_once,
]


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_recording(name: str) -> None:
    """Everything that is checked of a recording, on one replay; all that fails is told."""
    failed = []
    for check in CHECKS:
        try:
            check(name)
        except AssertionError as error:
            failed.append(f"{check.__name__}: {error}")
    replayed.cache_clear()
    assert not failed, "\n".join(failed)
