"""Plans and schedules in other forms."""

from gcs.exports.handovers import FORMATS, export_handovers, parse_launch, umask, write_atomic
from gcs.exports.plan_summary import summary

__all__ = ["FORMATS", "export_handovers", "parse_launch", "summary", "umask", "write_atomic"]
