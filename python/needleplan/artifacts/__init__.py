"""Artefacts (files that needleplan writes): their digests, the program version, and atomic writing."""

from needleplan.artifacts.file_kinds import FORMATS, FileFormat, FileKind, file_format, other_kind, version_advice
from needleplan.artifacts.files import (
    Parent,
    digest,
    expect_new,
    is_device,
    json_values,
    move_into_place,
    read_key,
    require_different,
    require_folder,
    require_key,
    require_new,
    require_writable,
    version,
    whole_file,
    write_whole,
)
from needleplan.artifacts.read_files import may_replace, recorded_reads, require_unread, was_read
from needleplan.artifacts.short_repr import MOST_CHARACTERS, short_repr

__all__ = [
    "FORMATS",
    "MOST_CHARACTERS",
    "FileFormat",
    "FileKind",
    "Parent",
    "digest",
    "expect_new",
    "file_format",
    "is_device",
    "json_values",
    "may_replace",
    "move_into_place",
    "other_kind",
    "read_key",
    "recorded_reads",
    "require_different",
    "require_folder",
    "require_key",
    "require_new",
    "require_unread",
    "require_writable",
    "short_repr",
    "version",
    "version_advice",
    "was_read",
    "whole_file",
    "write_whole",
]
