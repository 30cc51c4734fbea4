"""Links on real sockets and a real pseudo-terminal: the grammar, and what happens when the other side misbehaves."""

from __future__ import annotations

import contextlib
import os
import pty
import select
import socket
import subprocess
import sys
import time
import tty
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from link.errors import EndpointError, EndpointUrlError
from link.transport import udp_tcp
from link.transport.endpoint import MAX_QUEUED_BYTES, Endpoint
from link.transport.opening import open_endpoint
from link.transport.udp_tcp import BACKOFF_S, PEER_SILENCE_S, STAND_S, UdpInEndpoint, unsent_bytes
from link.transport.url import LinkUrl, parse_url

FRAME = bytes([0xFD, 9, 0, 0, 0, 241, 190, 0, 0, 0]) + bytes(11)


def wait_until(condition: Callable[[], object], timeout_s: float = 5.0) -> None:
    """Polls; a condition that never comes is a failure, not a hang."""
    end = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < end, "did not happen"
        time.sleep(0.002)


def receive(endpoint: Endpoint, count: int = 1) -> list[bytes]:
    got: list[bytes] = []

    def enough() -> bool:
        got.extend(endpoint.receive())
        return len(got) >= count

    wait_until(enough)
    return got


class Clock:
    """A monotonic clock moved by hand."""

    def __init__(self) -> None:
        self.now_s = 1000.0

    def __call__(self) -> float:
        return self.now_s


@pytest.fixture
def udp() -> Iterator[tuple[UdpInEndpoint, Endpoint]]:
    with open_endpoint("udpin:127.0.0.1:0") as listener:
        assert isinstance(listener, UdpInEndpoint)
        with open_endpoint(f"udpout:127.0.0.1:{listener.local_address[1]}") as sender:
            yield listener, sender


# ---------------------------------------------------------------- the grammar


@pytest.mark.parametrize(
    ("url", "parsed"),
    [
        ("udpout:192.168.4.1:14550", LinkUrl("udpout", "192.168.4.1", 14550)),
        ("udpin:0.0.0.0:14540", LinkUrl("udpin", "0.0.0.0", 14540)),
        ("udpin:127.0.0.1:0", LinkUrl("udpin", "127.0.0.1", 0)),
        ("tcp:texel.example:5760", LinkUrl("tcp", "texel.example", 5760)),
        ("udpout:[fe80::1%eth0]:14550", LinkUrl("udpout", "fe80::1%eth0", 14550)),
        (" udpin:[::]:14550 ", LinkUrl("udpin", "::", 14550)),
        ("serial:/dev/ttyUSB0:57600", LinkUrl("serial", "/dev/ttyUSB0", 57600)),
        (
            "serial:/dev/serial/by-id/usb-Radio:1-port0:115200",
            LinkUrl("serial", "/dev/serial/by-id/usb-Radio:1-port0", 115200),
        ),
    ],
)
def test_urls(url: str, parsed: LinkUrl) -> None:
    assert parse_url(url) == parsed
    assert parse_url(str(parsed)) == parsed


@pytest.mark.parametrize(
    ("url", "problem"),
    [
        ("", "unknown kind ''"),
        ("14550", "unknown kind '14550'"),
        ("udp:127.0.0.1:14550", "unknown kind 'udp'"),
        ("UDPOUT:127.0.0.1:14550", "unknown kind 'UDPOUT'"),
        ("udpout", "unknown kind 'udpout'|missing"),
        ("udpout:14550", "host and port are missing"),
        ("udpout::14550", "the host is empty"),
        ("udpout:127.0.0.1:", "'' is not a number"),
        ("udpout:127.0.0.1:0", "port 0 is out of range, allowed is 1 to 65535"),
        ("udpin:127.0.0.1:65536", "port 65536 is out of range, allowed is 0 to 65535"),
        ("udpout:127.0.0.1:-1", "'-1' is not a number"),
        ("udpout:127.0.0.1:١٤", "is not a number"),
        ("tcp:127.0.0.1:5760.0", "is not a number"),
        ("tcp:http://x:80", "is not a host|brackets"),
        ("udpout:::1:14550", r"brackets, as in udpout:\[::1\]:14550"),
        ("udpout:[::1:14550", "brackets|not an IPv6"),
        ("udpout:[zz]:14550", "'zz' is not an IPv6 address"),
        ("udpout:a b:14550", "'a b' is not a host name"),
        ("serial:/dev/ttyUSB0", "device and baud rate are missing"),
        ("serial::57600", "the device is empty"),
        ("serial:/dev/ttyUSB0:300", "baud rate 300 is out of range"),
        ("udpout:127.0.0.1:99999999999999999999", "is not a number"),
    ],
)
def test_bad_urls_say_what_is_wrong_and_what_is_allowed(url: str, problem: str) -> None:
    with pytest.raises(EndpointUrlError, match=problem) as caught:
        open_endpoint(url)
    assert "udpout:HOST:PORT" in str(caught.value)
    assert caught.value.url == url


@given(st.text(max_size=40))
def test_any_text_is_a_url_or_a_clear_error(text: str) -> None:
    with contextlib.suppress(EndpointUrlError):
        assert parse_url(str(parse_url(text))) == parse_url(text)


def test_unknown_host_and_foreign_address() -> None:
    with pytest.raises(EndpointError, match=r"host 'no-such-host.invalid' is unknown"):
        open_endpoint("udpout:no-such-host.invalid:14550")
    with pytest.raises(EndpointError, match=r"no address 203.0.113.7; use 0.0.0.0 for all"):
        open_endpoint("udpin:203.0.113.7:14550")
    with pytest.raises(EndpointError, match="unknown"):
        open_endpoint(f"udpout:{'x' * 300}:14550")


# ---------------------------------------------------------------- UDP


def test_there_and_back(udp: tuple[UdpInEndpoint, Endpoint]) -> None:
    listener, sender = udp
    assert not listener.is_connected
    assert not listener.send(FRAME)  # nobody there yet
    assert listener.stats.frames_dropped == 1
    assert sender.send(FRAME)
    assert receive(listener) == [FRAME]
    assert listener.is_connected
    assert listener.send(FRAME + b"back")
    assert receive(sender) == [FRAME + b"back"]
    assert (sender.stats.frames_sent, sender.stats.bytes_sent) == (1, len(FRAME))
    assert (sender.stats.packets_received, sender.stats.bytes_received) == (1, len(FRAME) + 4)
    assert not listener.url.is_stream
    assert sender.fileno() >= 0


def test_nothing_there_is_an_empty_list_at_once(udp: tuple[UdpInEndpoint, Endpoint]) -> None:
    listener, sender = udp
    assert listener.receive() == sender.receive() == []


def test_ipv6() -> None:
    try:
        listener = open_endpoint("udpin:[::1]:0")
    except EndpointError:
        pytest.skip("this machine has no IPv6 loopback")
    with listener, open_endpoint(f"udpout:[::1]:{listener.local_address[1]}") as sender:  # type: ignore[attr-defined]
        assert listener.is_loopback
        assert sender.is_loopback
        sender.send(FRAME)
        assert receive(listener) == [FRAME]


def test_what_counts_as_loopback() -> None:
    with open_endpoint("udpin:127.0.0.1:0") as inside, open_endpoint("udpin:0.0.0.0:0") as everywhere:
        assert inside.is_loopback
        assert not everywhere.is_loopback
    with open_endpoint("udpout:127.8.8.8:9") as inside, open_endpoint("udpout:localhost:9") as named:
        assert inside.is_loopback
        assert named.is_loopback
        # A name with both kinds of address: IPv4, where autopilots listen.
        assert named.local_address[0] == "127.0.0.1"  # type: ignore[attr-defined]


def test_a_port_is_never_shared() -> None:
    """Two sockets on one port steal each other's packets silently: the second one is told."""
    with open_endpoint("udpin:127.0.0.1:0") as first:
        port = first.local_address[1]  # type: ignore[attr-defined]
        with pytest.raises(EndpointError, match=rf"udpin:127.0.0.1:{port}: the port is taken by another program"):
            open_endpoint(f"udpin:127.0.0.1:{port}")
        # Not even with a program that sets the reuse options itself, as mavutil does.
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as greedy:
            greedy.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            greedy.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEPORT, 1)
            with pytest.raises(OSError, match="in use"):
                greedy.bind(("127.0.0.1", port))
    # Closed: free again.
    open_endpoint(f"udpin:127.0.0.1:{port}").close()


def test_sending_to_a_dead_port_never_raises_and_recovers() -> None:
    with open_endpoint("udpin:127.0.0.1:0") as listener:
        port = listener.local_address[1]  # type: ignore[attr-defined]
    with open_endpoint(f"udpout:127.0.0.1:{port}") as sender:
        for _ in range(20):
            sender.send(FRAME)
            sender.receive()
            time.sleep(0.001)
        assert sender.stats.send_errors + sender.stats.receive_errors > 0
        assert "refused" in sender.stats.last_error
        with open_endpoint(f"udpin:127.0.0.1:{port}") as listener:
            # The last refusal may still be pending; the one after it goes through.
            sender.send(FRAME)
            sender.send(FRAME)
            assert receive(listener)[0] == FRAME


def test_udpout_hears_its_peer_alone(udp: tuple[UdpInEndpoint, Endpoint]) -> None:
    listener, sender = udp
    sender.send(FRAME)
    receive(listener)
    address = sender.local_address  # type: ignore[attr-defined]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        stranger.sendto(FRAME + b"stranger", address)
        listener.send(FRAME)
        assert receive(sender) == [FRAME]
        time.sleep(0.02)
        assert sender.receive() == []


def test_only_what_looks_like_mavlink_makes_a_peer() -> None:
    with (
        open_endpoint("udpin:127.0.0.1:0") as listener,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger,
    ):
        assert isinstance(listener, UdpInEndpoint)
        for data in (b"", b"GET / HTTP/1.0", b"\x00\xfd"):
            stranger.sendto(data, listener.local_address)
        wait_until(lambda: listener.receive() or listener.stats.packets_ignored == 3)
        assert listener.peers == ()
        assert not listener.send(FRAME)


def test_every_live_peer_is_sent_to_and_a_silent_one_is_forgotten() -> None:
    clock = Clock()
    with (
        open_endpoint("udpin:127.0.0.1:0", clock=clock) as listener,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as a,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as b,
    ):
        assert isinstance(listener, UdpInEndpoint)
        for peer in (a, b):
            peer.settimeout(2.0)
            peer.sendto(FRAME, listener.local_address)
        receive(listener, 2)
        assert listener.send(FRAME)
        assert (a.recv(100), b.recv(100)) == (FRAME, FRAME)
        clock.now_s += PEER_SILENCE_S + 1.0
        b.sendto(FRAME, listener.local_address)
        receive(listener)
        assert [address[1] for address in listener.peers] == [b.getsockname()[1]]
        # The last one heard is kept however long the vehicle fades: setpoints must still reach it.
        clock.now_s += 3600.0
        listener.receive()
        assert listener.send(FRAME)
        assert b.recv(100) == FRAME


def test_a_burst_is_not_lost(udp: tuple[UdpInEndpoint, Endpoint]) -> None:
    """Two hundred datagrams before the first is read: the usual buffer overran at a hundred."""
    listener, sender = udp
    for number in range(200):
        assert sender.send(FRAME + number.to_bytes(2, "big") + bytes(60))
    got = receive(listener, 200)
    assert [int.from_bytes(g[len(FRAME) : len(FRAME) + 2], "big") for g in got] == list(range(200))


def test_a_flood_does_not_hold_the_caller(udp: tuple[UdpInEndpoint, Endpoint]) -> None:
    """One call returns a bounded number of packets however many are waiting."""
    listener, sender = udp
    assert len(listener.receive()) <= 1000
    for _ in range(100):
        sender.send(FRAME)
    assert 0 < len(receive(listener, 1)) <= 1000


def test_closed_endpoints_drop_and_stay_quiet(udp: tuple[UdpInEndpoint, Endpoint]) -> None:
    listener, sender = udp
    sender.send(FRAME)
    receive(listener)
    for endpoint in udp:
        endpoint.close()
        assert endpoint.receive() == []
        assert not endpoint.send(FRAME)
        assert not endpoint.is_connected
        assert endpoint.fileno() == -1
        endpoint.close()


def test_an_oversized_frame_is_dropped_and_counted(udp: tuple[UdpInEndpoint, Endpoint]) -> None:
    _, sender = udp
    assert not sender.send(bytes(70_000))
    assert (sender.stats.frames_dropped, sender.stats.send_errors) == (1, 1)
    assert sender.send(FRAME)


# ---------------------------------------------------------------- TCP


@contextlib.contextmanager
def tcp_server(port: int = 0) -> Iterator[socket.socket]:
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as server:
        server.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        server.bind(("127.0.0.1", port))
        server.listen(1)
        server.settimeout(5.0)
        yield server


def test_tcp_there_and_back() -> None:
    with tcp_server() as server, open_endpoint(f"tcp:127.0.0.1:{server.getsockname()[1]}") as endpoint:
        connection, _ = server.accept()
        with connection:
            wait_until(lambda: endpoint.receive() or endpoint.is_connected)
            assert endpoint.url.is_stream
            assert endpoint.is_loopback
            assert endpoint.send(FRAME)
            connection.settimeout(5.0)
            assert connection.recv(1000) == FRAME
            connection.sendall(FRAME)
            assert b"".join(receive(endpoint)) == FRAME
            assert endpoint.stats.connects == 1


def test_tcp_connects_when_the_other_side_comes_up_with_growing_pauses() -> None:
    clock = Clock()
    with tcp_server() as server:
        port = server.getsockname()[1]
    with open_endpoint(f"tcp:127.0.0.1:{port}", clock=clock) as endpoint:
        for _ in range(3):
            endpoint.receive()
        assert not endpoint.is_connected
        assert not endpoint.send(FRAME)
        assert endpoint.stats.frames_dropped == 1
        assert "refused" in endpoint.stats.last_error
        with tcp_server(port) as server:
            # The pause is not over: no attempt.
            endpoint.receive()
            assert not select.select([server], [], [], 0.05)[0]
            clock.now_s += BACKOFF_S[0] + 0.01
            wait_until(lambda: endpoint.receive() or endpoint.is_connected)
            connection, _ = server.accept()
            with connection:
                assert endpoint.send(FRAME)
                connection.settimeout(5.0)
                assert connection.recv(100) == FRAME


def test_tcp_comes_back_after_the_other_side_died() -> None:
    clock = Clock()
    with tcp_server() as server:
        port = server.getsockname()[1]
        with open_endpoint(f"tcp:127.0.0.1:{port}", clock=clock) as endpoint:
            connection, _ = server.accept()
            wait_until(lambda: endpoint.receive() or endpoint.is_connected)
            connection.close()
            wait_until(lambda: endpoint.receive() or not endpoint.is_connected)
            assert endpoint.fileno() == -1
            assert not endpoint.send(FRAME)
            clock.now_s += BACKOFF_S[1] + 1.0
            wait_until(lambda: endpoint.receive() or endpoint.is_connected)
            connection, _ = server.accept()
            connection.close()
            assert endpoint.stats.connects == 2


def test_tcp_to_a_reader_that_stopped_keeps_nothing_back() -> None:
    """Old setpoints are worse than none. With a full queue whole frames are dropped; the stream stays aligned."""
    with tcp_server() as server:
        server.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        with open_endpoint(f"tcp:127.0.0.1:{server.getsockname()[1]}") as endpoint:
            connection, _ = server.accept()
            wait_until(lambda: endpoint.receive() or endpoint.is_connected)
            sent = 0
            while endpoint.send(bytes([0xFD]) + sent.to_bytes(4, "big") + bytes(250)):
                sent += 1
                assert sent < 1_000_000
            for _ in range(100):
                assert not endpoint.send(bytes(255))
            assert endpoint.stats.frames_dropped == 101
            assert unsent_bytes(endpoint.fileno()) <= MAX_QUEUED_BYTES + 255
            with connection:
                connection.settimeout(0.5)
                data = bytearray()
                with contextlib.suppress(TimeoutError):
                    while True:
                        data += connection.recv(65536)
                        if len(data) >= sent * 255:
                            break
                assert len(data) == sent * 255
                assert [int.from_bytes(data[i * 255 + 1 : i * 255 + 5], "big") for i in range(sent)] == list(
                    range(sent)
                )
                # And the link is usable again.
                wait_until(lambda: endpoint.send(FRAME))


def read_on(connection: socket.socket) -> None:
    """Read until the other side ends it."""
    while connection.recv(65536):
        pass


def test_a_tcp_queue_that_stands_is_thrown_away_and_the_connection_begun_anew() -> None:
    """A reader that stalls gets nothing of before: the connection is reset, and the next one has new frames."""
    clock = Clock()
    with tcp_server() as server:
        server.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        with open_endpoint(f"tcp:127.0.0.1:{server.getsockname()[1]}", clock=clock) as endpoint:
            connection, _ = server.accept()
            wait_until(lambda: endpoint.receive() or endpoint.is_connected)
            while endpoint.send(bytes(255)):
                pass
            clock.now_s += STAND_S - 0.05
            assert not endpoint.send(FRAME)
            assert endpoint.is_connected
            clock.now_s += 0.5
            assert not endpoint.send(FRAME)
            assert "its queue stood" in endpoint.stats.last_error
            with connection:
                connection.settimeout(2.0)
                with pytest.raises(ConnectionResetError):
                    read_on(connection)
            clock.now_s += 0.1
            wait_until(lambda: endpoint.receive() or endpoint.is_connected)
            again, _ = server.accept()
            with again:
                again.settimeout(2.0)
                assert endpoint.send(FRAME)
                assert again.recv(65536) == FRAME


def test_a_tcp_queue_that_moves_however_slowly_does_not_stand() -> None:
    clock = Clock()
    with tcp_server() as server, open_endpoint(f"tcp:127.0.0.1:{server.getsockname()[1]}", clock=clock) as endpoint:
        connection, _ = server.accept()
        with connection:
            wait_until(lambda: endpoint.receive() or endpoint.is_connected)
            for _ in range(20):
                assert endpoint.send(FRAME)
                wait_until(lambda: unsent_bytes(endpoint.fileno()) == 0)
                clock.now_s += 1.0
            assert endpoint.stats.connects == 1


@pytest.mark.parametrize("round_trip_s", [0.05, 0.3, 0.6, 1.5])
def test_a_slow_tcp_link_that_answers_is_never_reset(monkeypatch: pytest.MonkeyPatch, round_trip_s: float) -> None:
    """What is on its way counts as queued until it is acknowledged: that is no queue that stands."""
    clock, sent = Clock(), list[tuple[float, int]]()

    def on_its_way(_: int) -> int:
        return sum(size for at_s, size in sent if clock.now_s - at_s < round_trip_s)

    monkeypatch.setattr(udp_tcp, "unsent_bytes", on_its_way)
    monkeypatch.setattr(udp_tcp, "acknowledged_within_s", lambda _: round_trip_s)
    with tcp_server() as server, open_endpoint(f"tcp:127.0.0.1:{server.getsockname()[1]}", clock=clock) as endpoint:
        connection, _ = server.accept()
        with connection:
            wait_until(lambda: endpoint.receive() or endpoint.is_connected)
            for _ in range(160):
                clock.now_s += 0.125
                assert endpoint.send(FRAME)
                sent.append((clock.now_s, len(FRAME)))
            assert endpoint.stats.connects == 1


def test_the_kernel_tells_how_long_an_acknowledgement_may_take() -> None:
    """On the loopback under a tenth of a second, and more than nothing; of what is no TCP socket it tells nothing."""
    with tcp_server() as server, socket.create_connection(server.getsockname()) as connection:
        assert 0.0 < udp_tcp.acknowledged_within_s(connection) < 0.1
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        assert udp_tcp.acknowledged_within_s(other) == 0.0


def test_what_is_discarded_resets_tcp_and_leaves_datagrams_alone() -> None:
    with tcp_server() as server, open_endpoint(f"tcp:127.0.0.1:{server.getsockname()[1]}") as endpoint:
        connection, _ = server.accept()
        wait_until(lambda: endpoint.receive() or endpoint.is_connected)
        endpoint.discard("reset: a test")
        assert endpoint.stats.last_error == "reset: a test"
        with connection:
            connection.settimeout(2.0)
            with pytest.raises(ConnectionResetError):
                connection.recv(100)
        wait_until(lambda: endpoint.receive() or endpoint.is_connected)
        assert endpoint.stats.connects == 2
    with open_endpoint("udpout:127.0.0.1:9") as endpoint:
        endpoint.discard("reset: a test")
        assert endpoint.stats.last_error == ""


def test_tcp_gives_up_a_connection_nobody_answers() -> None:
    """A backlog of one that is full: the handshake hangs. After the pause the attempt is dropped and made anew."""
    clock = Clock()
    with tcp_server() as server:
        port = server.getsockname()[1]
        full = []
        for _ in range(4):
            filler = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
            filler.setblocking(False)
            filler.connect_ex(("127.0.0.1", port))
            full.append(filler)
        time.sleep(0.05)
        with open_endpoint(f"tcp:127.0.0.1:{port}", clock=clock) as endpoint:
            endpoint.receive()
            if endpoint.is_connected:
                pytest.skip("this kernel accepts beyond the backlog")
            clock.now_s += BACKOFF_S[0] + 0.01
            endpoint.receive()
            assert endpoint.stats.last_error == "no answer"
        for filler in full:
            filler.close()


# ---------------------------------------------------------------- serial


@pytest.fixture
def terminal() -> Iterator[tuple[int, str]]:
    """A pseudo-terminal in raw mode: (the other end, its device name)."""
    master, slave = pty.openpty()
    tty.setraw(slave)
    name = os.ttyname(slave)
    os.close(slave)
    os.set_blocking(master, False)
    yield master, name
    with contextlib.suppress(OSError):
        os.close(master)


def test_serial_there_and_back(terminal: tuple[int, str]) -> None:
    master, name = terminal
    with open_endpoint(f"serial:{name}:57600") as endpoint:
        assert endpoint.is_connected
        assert endpoint.url.is_stream
        assert not endpoint.is_loopback
        assert endpoint.receive() == []
        # Every byte value: no line discipline may touch them.
        everything = FRAME + bytes(range(256))
        assert endpoint.send(everything)
        got = bytearray()
        wait_until(lambda: got.extend(_read(master)) or len(got) >= len(everything))
        assert bytes(got) == everything
        os.write(master, everything)
        back = bytearray()
        wait_until(lambda: back.extend(b"".join(endpoint.receive())) or len(back) >= len(everything))
        assert bytes(back) == everything


def _read(descriptor: int) -> bytes:
    try:
        return os.read(descriptor, 65536)
    except BlockingIOError:
        return b""


def test_serial_device_that_is_not_there_yet(tmp_path: Path, terminal: tuple[int, str]) -> None:
    _, name = terminal
    clock = Clock()
    link = tmp_path / "radio"
    with open_endpoint(f"serial:{link}:57600", clock=clock) as endpoint:
        assert not endpoint.is_connected
        assert endpoint.fileno() == -1
        assert not endpoint.send(FRAME)
        assert "radio" in endpoint.stats.last_error
        link.symlink_to(name)
        endpoint.receive()
        assert not endpoint.is_connected
        clock.now_s += BACKOFF_S[0] + 0.01
        endpoint.receive()
        assert endpoint.is_connected
        assert endpoint.send(FRAME)


def test_serial_unplugged(terminal: tuple[int, str]) -> None:
    master, name = terminal
    with open_endpoint(f"serial:{name}:57600") as endpoint:
        os.close(master)
        wait_until(lambda: endpoint.receive() or not endpoint.is_connected)
        assert not endpoint.send(FRAME)
        assert endpoint.stats.last_error


def test_serial_is_opened_for_ourselves_alone(terminal: tuple[int, str]) -> None:
    _, name = terminal
    with open_endpoint(f"serial:{name}:57600") as first, open_endpoint(f"serial:{name}:57600") as second:
        assert first.is_connected
        assert not second.is_connected
        assert "lock" in second.stats.last_error.lower()


def test_serial_full_queue_drops_whole_frames(terminal: tuple[int, str]) -> None:
    master, name = terminal
    with open_endpoint(f"serial:{name}:57600") as endpoint:
        sent = 0
        while endpoint.send(bytes([0xFD]) + sent.to_bytes(4, "big") + bytes(95)):
            sent += 1
            assert sent < 100_000
        got = bytearray()
        wait_until(lambda: got.extend(_read(master)) or endpoint.send(b"\xfd" + bytes(99)))
        wait_until(lambda: got.extend(_read(master)) or len(got) >= (sent + 1) * 100)
        assert len(got) == (sent + 1) * 100
        assert all(got[i] == 0xFD for i in range(0, len(got), 100))


# ---------------------------------------------------------------- across processes


def test_two_processes_over_udp() -> None:
    """The other side is a program of its own, as in a flight."""
    code = (
        "import socket, sys\n"
        "s = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)\n"
        "s.bind(('127.0.0.1', 0)); print(s.getsockname()[1], flush=True)\n"
        "s.settimeout(10)\n"
        "data, who = s.recvfrom(2000); s.sendto(data[::-1], who)\n"
    )
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as other:
        assert other.stdout is not None
        with open_endpoint(f"udpout:127.0.0.1:{int(other.stdout.readline())}") as endpoint:
            assert endpoint.send(FRAME)
            assert receive(endpoint) == [FRAME[::-1]]
        assert other.wait(10) == 0
