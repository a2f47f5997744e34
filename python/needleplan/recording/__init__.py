"""Recordings: measurements as files."""

from needleplan.recording.align import align
from needleplan.recording.files import parse_records, read_records, write_records
from needleplan.recording.importers import read_depth_force, read_stepwise_insertion

__all__ = [
    "align",
    "parse_records",
    "read_depth_force",
    "read_records",
    "read_stepwise_insertion",
    "write_records",
]
