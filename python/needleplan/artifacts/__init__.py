"""Artefacts (files that needleplan writes): their digests, the program version, and atomic writing."""

from needleplan.artifacts.files import (
    Parent,
    digest,
    expect_new,
    is_device,
    json_values,
    move_into_place,
    read_key,
    require_different,
    require_key,
    require_new,
    require_writable,
    version,
    whole_file,
    write_whole,
)

__all__ = [
    "Parent",
    "digest",
    "expect_new",
    "is_device",
    "json_values",
    "move_into_place",
    "read_key",
    "require_different",
    "require_key",
    "require_new",
    "require_writable",
    "version",
    "whole_file",
    "write_whole",
]
