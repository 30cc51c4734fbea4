"""The lossy link: shares, delays and cuts in virtual time; and the process on real sockets."""

from __future__ import annotations

import itertools
import math
import socket
import subprocess
import sys

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sitl_fixtures.errors import ConfigurationError
from sitl_fixtures.process import Impairment, LossyChannel
from sitl_fixtures.process.proxy import main
from tests.support.flights.processes import free_ports


def passed(channel: LossyChannel, count: int, interval_s: float = 0.02) -> list[tuple[float, int]]:
    """(arrival, number) of numbered datagrams sent at an interval."""
    found = []
    for number in range(count):
        now = number * interval_s
        channel.send(number.to_bytes(4, "little"), now)
        found += [(now, int.from_bytes(data, "little")) for data in channel.receive(now)]
    end = count * interval_s + 100.0
    return found + [(end, int.from_bytes(data, "little")) for data in channel.receive(end)]


def test_a_clean_channel_passes_everything_in_order() -> None:
    assert [n for _, n in passed(LossyChannel(Impairment()), 500)] == list(range(500))


def test_latency_is_exact() -> None:
    channel = LossyChannel(Impairment(latency_s=0.25))
    channel.send(b"x", 1.0)
    assert channel.next_event_s() == 1.25
    assert channel.receive(1.2499) == []
    assert channel.receive(1.25) == [b"x"]
    assert channel.next_event_s() == math.inf


@pytest.mark.parametrize("loss", [0.05, 0.3, 0.7])
@pytest.mark.parametrize("burst", [1.0, 5.0])
def test_the_share_lost_is_as_asked_in_runs_as_asked(loss: float, burst: float) -> None:
    channel = LossyChannel(Impairment(loss=loss, burst=burst), seed=1)
    arrived = {n for _, n in passed(channel, 40_000)}
    fate = [n in arrived for n in range(40_000)]
    assert fate.count(False) / len(fate) == pytest.approx(loss, abs=0.03)
    runs = "".join("x" if not ok else " " for ok in fate).split()
    mean = sum(map(len, runs)) / len(runs)
    assert mean == pytest.approx(burst if burst > 1.0 else 1.0 / (1.0 - loss), rel=0.1)


def test_duplication_and_reordering() -> None:
    numbers = [n for _, n in passed(LossyChannel(Impairment(duplication=0.2, reordering=0.2), seed=2), 5000)]
    assert len(numbers) == pytest.approx(6000, rel=0.03)
    assert set(numbers) == set(range(5000))
    late = sum(b < a for a, b in itertools.pairwise(numbers))
    assert late > 500


def test_a_cut_loses_what_is_sent_into_it_and_what_is_under_way() -> None:
    channel = LossyChannel(Impairment(latency_s=0.1, cuts=((2.0, 3.0),)))
    arrived = {n for _, n in passed(channel, 500, 0.01)}
    assert not arrived & set(range(190, 300))
    assert set(range(189)) <= arrived
    assert set(range(300, 500)) <= arrived


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10_000), st.floats(0, 1), st.floats(0, 1), st.floats(0, 1), st.floats(0, 1), st.floats(0, 1))
def test_nothing_is_made_up_and_the_seed_decides(
    seed: int, loss: float, jitter: float, again: float, late: float, latency: float
) -> None:
    impairment = Impairment(loss, 1.0, latency, jitter, again, late)
    first, second = (passed(LossyChannel(impairment, seed), 50) for _ in range(2))
    assert first == second
    numbers = [n for _, n in first]
    assert set(numbers) <= set(range(50))
    assert max((numbers.count(n) for n in set(numbers)), default=0) <= 2


def test_a_cut_does_not_change_the_fate_of_what_comes_after() -> None:
    plain = {n for _, n in passed(LossyChannel(Impairment(loss=0.3), 5), 1000)}
    cut = {n for _, n in passed(LossyChannel(Impairment(loss=0.3, cuts=((2.0, 4.0),)), 5), 1000)}
    assert {n for n in plain if n >= 200} == {n for n in cut if n >= 200}


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"loss": 1.1}, "--loss"),
        ({"loss": math.nan}, "--loss"),
        ({"latency_s": -1.0}, "--latency"),
        ({"burst": 0.5}, "--burst"),
        ({"cuts": ((3.0, 2.0),)}, "--cut"),
    ],
)
def test_impossible_impairments_are_named(options: dict[str, object], words: str) -> None:
    with pytest.raises(ConfigurationError, match=words):
        Impairment(**options)  # type: ignore[arg-type]


def test_bad_options_end_with_two(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--listen", "udpin:127.0.0.1:0", "--target", "udpout:127.0.0.1:1"]) == 2
    assert main(["--listen", "udpin:127.0.0.1:9", "--target", "udpout:127.0.0.1:1", "--cut", "soon"]) == 2
    assert "--cut" in capsys.readouterr().err


@pytest.mark.slow
def test_the_process_relays_both_ways() -> None:
    """Through real sockets: everything sent comes back, delayed twice by the latency."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as far:
        far.bind(("127.0.0.1", 0))
        far.settimeout(10.0)
        port = free_ports(1)[0]
        process = subprocess.Popen(
            [
                *[sys.executable, "-m", "sitl_fixtures.process.proxy", "--listen", f"udpin:127.0.0.1:{port}"],
                *["--target", f"udpout:127.0.0.1:{far.getsockname()[1]}", "--latency", "0.05"],
            ],
            stdout=subprocess.PIPE,
            text=True,
        )
        try:
            assert process.stdout is not None
            assert process.stdout.readline().startswith("ready proxy")
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as near:
                near.settimeout(10.0)
                for number in range(20):
                    near.sendto(bytes((number,)), ("127.0.0.1", port))
                    data, peer = far.recvfrom(100)
                    far.sendto(data + b"!", peer)
                    assert near.recv(100) == bytes((number,)) + b"!"
        finally:
            process.terminate()
            output = process.communicate(timeout=10.0)[0]
        assert "up: 20 of 20 delivered" in output
        assert process.returncode == 0
