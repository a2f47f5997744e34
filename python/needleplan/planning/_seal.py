"""The seal in front of a policy table, and its optional signature.

The seal is the first 512 bytes of the file: a line with the format, the length of the rest and its SHA-256, and zeros
up to 512 bytes. It detects damage and changes by mistake. Whoever changes a table on purpose can compute a new seal. A
signature detects this too: it is the HMAC-SHA256 of the first line under a secret key, in a second line. Because the
first line holds the SHA-256 of the rest, the signature holds for the whole file. Both are verified before HDF5 parses
the file.
"""

from __future__ import annotations

import hashlib
import hmac
import os
from pathlib import Path
from typing import BinaryIO

from needleplan.artifacts import FORMATS, FileKind, digest, present_format, require_key, version_advice
from needleplan.errors import ChecksumError, Mistake, TableError

__all__ = ["FORMAT", "SEAL_BYTES", "is_signed", "seal", "seal_of_file", "verify"]

# First word of a file: format and version. Former names of the same format are read, too.
FORMAT = FORMATS[FileKind.TABLE]

# Size (bytes) of the seal; the HDF5 user block must have 512 bytes or a larger power of two.
SEAL_BYTES = 512
_HDF5 = b"\x89HDF\r\n\x1a\n"
_SIGNATURE = b"hmac-sha256:"
# Size (bytes) of the pieces in which a file is read.
_PIECE_BYTES = 2**22


def seal(body: memoryview, key: bytes | None = None) -> bytes:
    """Return the seal of `body`, the rest of a file; with a signature if `key` is given."""
    return _front(f"{FORMAT} {len(body)} bytes {digest(body)}\n".encode(), key)


def seal_of_file(stream: BinaryIO, key: bytes | None = None, form: str = FORMAT) -> bytes:
    """Return the seal of an open file: of its bytes from the end of the seal on, which are read piece by piece."""
    size = stream.seek(0, os.SEEK_END) - SEAL_BYTES
    stream.seek(SEAL_BYTES)
    hashed = hashlib.sha256()
    while piece := stream.read(_PIECE_BYTES):
        hashed.update(piece)
    return _front(f"{form} {size} bytes sha256:{hashed.hexdigest()}\n".encode(), key)


def _front(line: bytes, key: bytes | None) -> bytes:
    return (line + (_signature(line, key) if key else b"")).ljust(SEAL_BYTES, b"\0")


def is_signed(path: str | os.PathLike[str]) -> bool:
    """Return whether a table file has a signature, which is not verified. Raises OSError if it cannot be read."""
    with Path(path).open("rb") as stream:
        return b"\n" + _SIGNATURE in stream.read(SEAL_BYTES)


def verify(stream: BinaryIO, source: str, key: bytes | None = None) -> None:
    """Verify the seal of an open file, and its signature if `key` is given.

    Raises TableError if the file is not a policy table, or truncated, and ChecksumError if its bytes do not
    agree with the seal, or the file is not signed with `key`.
    """
    stream.seek(0)
    front = stream.read(SEAL_BYTES)
    line, _, rest = front.partition(b"\n")
    words = line.split(b" ")
    name = words[0].decode(errors="replace")
    if present_format(name) != FORMAT or len(words) != 4 or not words[1].isdigit():
        if advice := version_advice(name, FORMAT):
            rule = f"another version; this needleplan reads {FORMAT}: {advice}"
            raise TableError(Mistake("format", name, rule), source)
        kind = "an HDF5 file, but not a sealed policy table" if front.startswith(_HDF5) else "not a policy table"
        raise TableError(f"is {kind}: it must begin with {FORMAT}", source)
    expected, size = int(words[1]), stream.seek(0, os.SEEK_END) - SEAL_BYTES
    if size < expected:
        raise TableError(f"is truncated: {max(size, 0):,} of {expected:,} bytes are there", source)
    signed = rest.startswith(_SIGNATURE)
    signature = rest[: len(_SIGNATURE) + 65] if signed else b""
    if front != (seal_of_file(stream, None, name).rstrip(b"\0") + signature).ljust(SEAL_BYTES, b"\0"):
        raise ChecksumError("has been altered since it was written: its SHA-256 is not that of its seal", source)
    if key and not signed:
        raise ChecksumError("is not signed: write it with a key, `needleplan plan --sign-key FILE`", source)
    if key and not hmac.compare_digest(signature, _signature(line + b"\n", key)):
        raise ChecksumError("is signed with another key, or has been altered and sealed again", source)


def _signature(line: bytes, key: bytes) -> bytes:
    require_key(key)
    return _SIGNATURE + hmac.new(key, line, hashlib.sha256).hexdigest().encode() + b"\n"
