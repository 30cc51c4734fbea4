"""The report of a flight drawn: one file, with everything in it."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from api.cli.commands import report as command
from api.cli.errors import BadInputError
from link.errors import ReportError
from link.files.drawn import page
from link.files.flight_report import report_and_traces
from tests.support.flights.recorded import plan, recorded, stepped

PLAN = plan()


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    data = recorded("ardupilot", 1)
    half = len(data) // 2
    path = tmp_path_factory.mktemp("drawn") / "flight.tlog"
    path.write_bytes(data[:half] + stepped(data, 0.0)[half + 4000 :])
    return path


@pytest.mark.slow
def test_one_page_holds_every_figure_and_what_is_wrong_with_the_log(log: Path) -> None:
    found, traces = report_and_traces(log, PLAN)
    text = page.draw(PLAN, found, traces, "html").decode()
    assert text.count('src="data:image/svg+xml;base64,') == text.count("<img") == 6
    assert not re.search(r'(src|href)="(?!data:)', text)
    assert "frames of the stations are missing" in text
    assert "as far as the damaged log tells" in text


@pytest.mark.slow
def test_a_pdf(log: Path) -> None:
    found, traces = report_and_traces(log, PLAN)
    data = page.draw(PLAN, found, traces, "pdf")
    assert data.startswith(b"%PDF")
    assert data.count(b"/Type /Page ") + data.count(b"/Type /Page\n") >= 7


def test_without_matplotlib_it_is_said_what_to_install(log: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found, traces = report_and_traces(log, PLAN)
    monkeypatch.setattr(page, "can_draw", lambda: False)
    with pytest.raises(ReportError, match=r"pip install 'skyrelay\[report\]'"):
        page.draw(PLAN, found, traces, "html")


def test_a_file_of_another_kind_is_refused() -> None:
    assert command._wanted(["a.HTML", "b.pdf"], "c", None) == [("c", "html"), ("a.HTML", "html"), ("b.pdf", "pdf")]
    with pytest.raises(BadInputError) as refused:
        command._wanted(["flight.docx"], None, None)
    assert "ends in .html or .pdf" in refused.value.block()
