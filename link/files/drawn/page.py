"""A flight's report as one file: HTML with its figures inside, or PDF."""

from __future__ import annotations

import base64
import html
import importlib.util
import io
from datetime import UTC, datetime
from typing import Any

from gcs.plan import Plan
from gcs.timestamps import utc_text
from link.errors import ReportError
from link.files.flight_report import FlightReport, FlightTraces

_STYLE = """
body{font:15px/1.45 system-ui,sans-serif;color:#1c1c1c;background:#fff;margin:0 auto;padding:1rem;max-width:64rem}
h1{font-size:1.35rem;margin:.2rem 0}h2{font-size:1rem;margin:1.4rem 0 .4rem}
.verdict{padding:.5rem .8rem;border-left:4px solid #2e7d32;background:#f1f7f1}
.verdict.not{border-color:#c0392b;background:#fbf0ef}
.verdict.unsure{border-color:#b26a00;background:#fdf6ea}
.damage{padding:.5rem .8rem;border-left:4px solid #b26a00;background:#fdf6ea}.damage p{margin:.2rem 0}
figure{margin:1rem 0}.map{max-width:46rem}figure img{width:100%;height:auto}figcaption{color:#555;font-size:.9rem}
.grid{display:grid;grid-template-columns:repeat(auto-fit,minmax(min(26rem,100%),1fr));gap:0 1.5rem}
.scroll{overflow-x:auto}pre{font-size:.85rem;white-space:pre}
""".replace("\n", "")


def can_draw() -> bool:
    """Whether matplotlib, which draws, is installed."""
    return importlib.util.find_spec("matplotlib") is not None


def draw(plan: Plan, report: FlightReport, traces: FlightTraces, form: str) -> bytes:
    """The page, ``form`` "html" or "pdf". Raises `ReportError` where matplotlib is not installed."""
    if not can_draw():
        raise ReportError("the flight cannot be drawn: matplotlib is not installed (pip install 'skyrelay[report]')")
    from link.files.drawn.figures import figures

    drawn = figures(plan, report, traces)
    return _pdf(plan, report, drawn) if form == "pdf" else _html(plan, report, drawn)


def _title(plan: Plan, report: FlightReport) -> str:
    return f"{plan.mission.name}, T+0 {utc_text(datetime.fromtimestamp(report.launched_unix_s, UTC))}"


def _html(plan: Plan, report: FlightReport, drawn: list[tuple[str, str, Any]]) -> bytes:
    title, verdict = html.escape(_title(plan, report)), html.escape(report.verdict)
    sure = " not" if report.not_planned else " unsure" if report.damage.lines else ""
    pictures = {}
    for name, caption, figure in drawn:
        data = io.BytesIO()
        figure.savefig(data, format="svg", metadata={"Date": None})
        source = base64.b64encode(data.getvalue()).decode()
        text = html.escape(caption)
        pictures[name] = (
            f'<figure class="{name}"><img alt="{text}" src="data:image/svg+xml;base64,{source}">'
            f"<figcaption>{text}</figcaption></figure>"
        )
    lines = [*report.damage.lines, *report.damage.clock_lines]
    damage = "".join(f"<p>{html.escape(line)}</p>" for line in lines)
    rest = "".join(picture for name, picture in pictures.items() if name != "map")
    return (
        '<!DOCTYPE html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width,initial-scale=1">'
        f"<title>Flight report: {title}</title><style>{_STYLE}</style></head><body>"
        f"<h1>Flight report: {title}</h1>"
        f'<p class="verdict{sure}">{verdict}</p>'
        + (f'<div class="damage">{damage}</div>' if damage else "")
        + pictures["map"]
        + f'<div class="grid">{rest}</div><h2>Figures</h2>'
        f'<div class="scroll"><pre>{html.escape(report.to_text())}</pre></div>'
        "<p>Dotted lines: handovers. Shaded: holes of the log.</p></body></html>\n"
    ).encode()


def _pdf(plan: Plan, report: FlightReport, drawn: list[tuple[str, str, Any]]) -> bytes:
    from matplotlib.backends.backend_pdf import PdfPages
    from matplotlib.figure import Figure

    data = io.BytesIO()
    with PdfPages(data) as pages:
        first = Figure(figsize=(8.27, 11.69))
        text = "\n".join(_wrapped(report.to_text()))
        first.text(
            0.07, 0.95, f"Flight report: {_title(plan, report)}", fontsize=12, weight="bold", va="top", wrap=True
        )
        first.text(0.07, 0.91, text, fontsize=7.5, family="monospace", va="top", parse_math=False)
        pages.savefig(first)
        for _, caption, figure in drawn:
            figure.axes[0].set_title(caption, fontsize=9, loc="left")
            pages.savefig(figure)
    return data.getvalue()


def _wrapped(text: str, width: int = 108) -> list[str]:
    import textwrap

    return [
        part for line in text.splitlines() for part in textwrap.wrap(line, width, subsequent_indent=" " * 14) or [""]
    ]
