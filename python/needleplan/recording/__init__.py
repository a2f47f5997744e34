"""Recordings: measurements as files."""

from needleplan.recording.align import align
from needleplan.recording.files import parse_records, read_records, write_records

__all__ = ["align", "parse_records", "read_records", "write_records"]
