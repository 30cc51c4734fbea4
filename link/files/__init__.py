"""MAVLink's own files and what is read off them: tlogs, setpoint files, reports."""

from link.files.change_journal import FileJournal
from link.files.drawn.page import draw
from link.files.flight_report import report_and_traces, report_flight
from link.files.setpoint_files import FORMATS, Format, setpoint_file
from link.files.tlog import read_tlog

__all__ = [
    "FORMATS",
    "FileJournal",
    "Format",
    "draw",
    "read_tlog",
    "report_and_traces",
    "report_flight",
    "setpoint_file",
]
