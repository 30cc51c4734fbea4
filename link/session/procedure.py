"""Sequences that wait: generators advanced once a tick, so that a procedure reads from top to bottom."""

from __future__ import annotations

from collections.abc import Callable, Generator
from typing import TypeVar

from link.microservices.command import Ticket
from link.session.timeline import Timeline

T = TypeVar("T")
Steps = Generator[None, None, T]
"""A procedure: every ``yield`` waits for the next tick, the return value is its result."""


class Refused(Exception):  # noqa: N818 - an outcome, not an error of ours
    """The flight does not start; the message is for people."""


def wait_until(timeline: Timeline, condition: Callable[[], bool], timeout_s: float) -> Steps[bool]:
    """Wait for a condition; whether it came true in time."""
    deadline_s = timeline.now_s + timeout_s
    while not condition():
        if timeline.now_s >= deadline_s:
            return False
        yield
    return True


def answered(ticket: Ticket) -> Steps[Ticket]:
    """Wait for a command's end."""
    while not ticket.finished:
        yield
    return ticket
