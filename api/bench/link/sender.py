"""The reference beside the streamer: a bare loop that sends one datagram at each absolute deadline, and nothing else.

``python -m api.bench.link.sender HOST PORT RATE_HZ SECONDS``. It asks for the same scheduling as the streamer does and
skips missed deadlines, so what it is late by is the machine's doing. It prints the scheduling it got.
"""

from __future__ import annotations

import gc
import socket
import sys
import time

FRAME_BYTES = 78
"""A signed setpoint: 53 bytes of payload, 12 of frame, 13 of signature."""


def main(arguments: list[str]) -> int:
    """Send until the time is up."""
    from link.clock import TickGrid
    from link.streamer import raise_priority

    host, port, rate_hz, seconds = arguments[0], int(arguments[1]), float(arguments[2]), float(arguments[3])
    sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sender.connect((host, port))
    frame = bytes(FRAME_BYTES)
    gc.collect()
    gc.freeze()
    print(raise_priority(), flush=True)  # noqa: T201 - what whoever started it wants to know
    start_s = time.monotonic()
    grid = TickGrid(rate_hz, start_s)
    while (now_s := time.monotonic()) < start_s + seconds:
        if grid.due(now_s) is not None:
            sender.send(frame)
        else:
            time.sleep(grid.deadline_s - now_s)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
