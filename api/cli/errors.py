"""What a command may fail with, and how that is said.

CommandError
├── BadInputError         exit 2   the caller can mend it: what, where, its value, what is allowed, what to do
├── InfeasibleError       exit 3   the mission has no plan: why, where, and the smallest fix
├── ContingencyError      exit 4   the flight ended in a contingency procedure
└── FaultError            exit 1   ours

A command raises; `api.cli.main` prints one block on standard error and ends with the exit code.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from typing import Any, ClassVar

EXIT_OK = 0
EXIT_FAULT = 1
EXIT_BAD_INPUT = 2
EXIT_INFEASIBLE = 3
EXIT_CONTINGENCY = 4
EXIT_INTERRUPTED = 130

_LABEL_WIDTH = 9
_LONGEST_VALUE = 200


class CommandError(Exception):
    """Base: a headline, and details as (label, text) lines under it.

    ``paragraphs`` holds one list of details per fault, so that several faults stay apart when printed.
    """

    exit_code: ClassVar[int] = EXIT_FAULT

    def __init__(self, headline: str, *paragraphs: Mapping[str, Any]) -> None:
        super().__init__(headline)
        self.headline = headline
        self.paragraphs = [{k: v for k, v in p.items() if v is not None and v != ""} for p in paragraphs]

    def block(self) -> str:
        """The whole message, lines of plain text without a final newline."""
        lines = [f"error: {self.headline}"]
        shown = [p for p in self.paragraphs if p]
        for number, paragraph in enumerate(shown):
            if number:
                lines.append("")
            for label, value in paragraph.items():
                first, *rest = text_of(value).splitlines() or [""]
                lines.append(f"  {label + ':':<{_LABEL_WIDTH}} {first}")
                lines.extend(" " * (_LABEL_WIDTH + 3) + line for line in rest)
        return "\n".join(lines)


class BadInputError(CommandError):
    """The caller gave something that cannot be used."""

    exit_code = EXIT_BAD_INPUT


class InfeasibleError(CommandError):
    """No plan exists for this mission."""

    exit_code = EXIT_INFEASIBLE


class ContingencyError(CommandError):
    """The flight did not end as planned."""

    exit_code = EXIT_CONTINGENCY


class FaultError(CommandError):
    """Something of ours went wrong."""


class Terminated(BaseException):
    """SIGTERM or SIGHUP: unwound like Ctrl-C, so that children are ended."""

    def __init__(self, signal_number: int) -> None:
        super().__init__(signal_number)
        self.signal_number = signal_number


def text_of(value: Any) -> str:
    """A value as a person reads it: text as it is, anything else as JSON, long values cut.

    Text that would do something to a terminal (control characters, half characters) is shown escaped.
    """
    text = value if isinstance(value, str) else json.dumps(value, ensure_ascii=False, default=str)
    if not all(line.isprintable() for line in text.split("\n")):
        text = json.dumps(text)
    return text if len(text) <= 1000 else text[:997] + "..."


def faults_as_paragraphs(faults: Iterable[Any]) -> list[dict[str, Any]]:
    """``InputFault(where, what, value, allowed, fix)`` objects of ``gcs.errors`` as paragraphs of a block."""
    return [
        {
            "where": f.where,
            "what": f.what,
            "value": None if f.value is None else _shortened(text_of(f.value)),
            "allowed": f.allowed,
            "fix": f.fix,
        }
        for f in faults
    ]


def _shortened(text: str) -> str:
    return text if len(text) <= _LONGEST_VALUE else text[: _LONGEST_VALUE - 3] + "..."
