"""skyrelay bench link: lateness by hand, the rates, and a short real flight beside the bare sender."""

from __future__ import annotations

import json
import socket
import time
from collections.abc import Callable

import numpy as np
import pytest

from api.bench.link import punctuality as bench_of
from api.bench.link.wiretap import Heard, Wiretap, lateness_ms, missed
from link.dialect import mavlink
from link.wire.codec import StationCodec
from link.wire.signing import Signing, SigningKey
from link.wire.signing_timestamps import SigningStore
from tests.support.processes.cli_process import Outcome

Cli = Callable[..., Outcome]


@pytest.mark.slow
def test_the_wire_layers_rates_come_beside_their_reference(cli: Cli) -> None:
    outcome = cli("bench", "link", "--only", "rates", "--json")
    assert (outcome.code, outcome.err) == (0, "")
    figures = json.loads(outcome.out)
    assert set(figures) == {"rates"}
    reference, *others = figures["rates"]
    assert reference["per_reference"] == pytest.approx(1.0)
    assert len(others) >= 5
    for rate in others:
        assert rate["per_reference"] == pytest.approx(reference["per_second"] / rate["per_second"])


def test_lateness_is_against_the_senders_own_grid() -> None:
    """A grid of 20 Hz that begins at 7.3; one sender in ten is 4 ms late, one 30 ms."""
    grid = 7.3 + np.arange(200) / 20.0
    late_s = np.zeros(200)
    late_s[::10] = 0.004
    late_s[55] = 0.030
    assert lateness_ms(grid + late_s, 20.0) == pytest.approx(late_s * 1e3, abs=1e-6)
    assert missed(grid + late_s, 20.0) == 0


def test_a_few_that_are_late_by_nearly_a_period_move_no_grid() -> None:
    grid = np.arange(20_000) / 20.0
    late_s = np.zeros(20_000)
    late_s[[500, 7_000, 12_345]] = 0.0485
    assert lateness_ms(grid + late_s, 20.0) == pytest.approx(late_s * 1e3, abs=1e-6)


def test_missed_deadlines_are_counted_and_charged_from_the_first_of_them() -> None:
    """Three deadlines pass unserved; the next datagram is 2 ms late at its own, 152 ms at the first it owed."""
    grid = np.arange(100) / 20.0
    late_s = np.zeros(100)
    late_s[43] = 0.002
    kept = np.delete(np.arange(100), [40, 41, 42])
    found = lateness_ms((grid + late_s)[kept], 20.0)
    assert found[40] == pytest.approx(152.0)
    assert np.delete(found, 40) == pytest.approx(0.0, abs=1e-6)
    assert missed(grid[kept], 20.0) == 3


def test_figures_of_a_sender_by_hand() -> None:
    heard = Heard([0.0, *(1.0 + k / 50.0 for k in range(101)), 9.0], [1] * 103)
    heard.time_s[51] += 0.005
    figures = bench_of.Lateness.of(heard, 50.0, "as it was", 0.5, 8.0)
    assert (figures.sent, figures.missed) == (101, 0)
    assert (figures.p50_ms, figures.max_ms) == (0.0, 5.0)
    assert figures.longest_gap_ms == 25.0


def test_the_wiretap_passes_on_both_ways_signs_for_the_vehicle_and_stamps_setpoints() -> None:
    key = SigningKey(bytes(range(1, 33)))

    def signing(link_id: int) -> Signing:
        return Signing(key, link_id, SigningStore.in_memory())

    station, vehicle = StationCodec(241, signing=signing(241)), StationCodec(1, 1)
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as far,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as near,
    ):
        far.bind(("127.0.0.1", 0))
        far.settimeout(5.0)
        near.settimeout(5.0)
        tap = Wiretap({"s1": far.getsockname()[1]}, StationCodec(1, 1, signing=signing(0)))
        near.connect(("127.0.0.1", int(tap.links["s1"].rsplit(":", 1)[1])))
        setpoint = mavlink.MAVLink_set_position_target_local_ned_message(
            0, 1, 1, 1, 0xC00, 1, 2, 3, 0, 0, 0, 0, 0, 0, 0, 0
        )
        beat = mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)
        before_s = time.monotonic()
        near.send(station.encode(setpoint))
        near.send(station.encode(beat))
        after_s = time.monotonic()
        time.sleep(0.05)  # read late, stamped when sent
        tap.run(lambda: len(tap.setpoints.time_s) > 0, 5.0)
        frames = [far.recvfrom(2048) for _ in range(2)]
        assert [m.get_type() for data, _ in frames for m in StationCodec(9).decode(data)] == [
            "SET_POSITION_TARGET_LOCAL_NED",
            "HEARTBEAT",
        ]
        assert before_s - 0.002 <= tap.setpoints.time_s[0] <= after_s + 0.002
        assert tap.setpoints.system_id == [241]
        far.sendto(vehicle.encode(mavlink.MAVLink_heartbeat_message(2, 12, 0, 0, 4, 3)), frames[0][1])
        tap.run(lambda: False, 0.2)
        (heard,) = station.decode(near.recv(2048))
        assert heard.get_signed()
        tap.close()


def test_a_bench_plan_is_long_enough_and_has_no_more_links_than_a_simulator() -> None:
    plan = bench_of.bench_plan(20.0)
    assert plan.mission_time_s >= 20.0
    assert len(plan.handovers) >= 1
    assert len(bench_of.bench_plan(1200.0).mission.stations) <= 32


@pytest.mark.slow
def test_a_short_real_flight_is_measured_beside_the_bare_sender(cli: Cli) -> None:
    options = ("--only", "lateness", "--seconds", "2", "--rate", "20", "--load", "idle", "--json")
    outcome = cli("bench", "link", *options)
    assert outcome.code == 0, outcome.err
    (run,) = json.loads(outcome.out)["runs"]
    assert (run["rate_hz"], run["load"], run["signed"]) == (20.0, "idle", True)
    for who in ("streamer", "reference"):
        # No figure is asserted: they are the machine's. What is counted must add up.
        assert run[who]["sent"] + run[who]["missed"] == pytest.approx(40, abs=3)
        assert 0.0 <= run[who]["p50_ms"] <= run[who]["p99_ms"] <= run[who]["max_ms"]
        assert run[who]["scheduling"] in ("SCHED_FIFO 10", "nice -10", "ordinary")
    assert run["streamer"]["scheduling"] == run["reference"]["scheduling"]
    assert run["vehicles_per_core"] == pytest.approx(1.0 / run["core_share"], rel=0.05)
