"""Artefacts: digests, the version that made them, and writing a file whole or not at all."""

from needleplan.artifacts.files import (
    Parent,
    digest,
    require_different,
    require_new,
    require_writable,
    version,
    write_whole,
)

__all__ = ["Parent", "digest", "require_different", "require_new", "require_writable", "version", "write_whole"]
