"""Bytes of volume files, read within the limits that the header and the memory set.

A header states the number of bytes of the voxels. They are compared with three limits before anything is allocated: the
memory, the size of the file, and, if it is compressed, 1032 times its size, the largest ratio of deflate.
"""

from __future__ import annotations

import gzip
import zlib
from typing import IO, TYPE_CHECKING

from needleplan.anatomy._volume import largest_bytes
from needleplan.errors import Mistake, ScenarioError

if TYPE_CHECKING:
    from collections.abc import Sequence

__all__ = ["counted_bytes", "exact_bytes", "require_size"]

# Bytes that planning needs for each voxel beside those of the file: labels (2), a sorted copy (2), meanings, obstacles,
# codes and their copies (8).
_PLANNING_BYTES = 12
# Largest ratio of the sizes of a text and its deflate stream.
_DEFLATE_RATIO = 1032


def counted_bytes(shape: Sequence[int], itemsize: int, key: str, source: str) -> int:
    """Return the number of bytes of the voxels of a volume.

    Raises ScenarioError if the volume is not 3-D, is empty, or planning in it needs more than half of the memory. `key`
    names the shape in messages.
    """
    sizes = [int(size) for size in shape]
    shown = " x ".join(map(str, sizes))
    if len(sizes) > 3 and all(size == 1 for size in sizes[3:]):
        sizes = sizes[:3]
    if len(sizes) != 3:
        rule = f"must be a volume of 3 dimensions, not {len(sizes)}; extract one volume, or export one layer"
        raise ScenarioError(Mistake(key, shown, rule), source)
    if min(sizes) < 1:
        raise ScenarioError(Mistake(key, shown, "must be positive"), source)
    voxels = sizes[0] * sizes[1] * sizes[2]
    needed, most = voxels * (itemsize + _PLANNING_BYTES), 2 * largest_bytes()
    if needed > most:
        rule = (
            f"needs {needed / 2**30:.1f} GiB to plan in; at most {most / 2**30:.1f} GiB fit here: crop or resample it"
        )
        raise ScenarioError(Mistake(key, shown, rule), source)
    return voxels * itemsize


def require_size(count: int, stored: int, compressed: bool, key: str, source: str) -> None:
    """Raise ScenarioError if a file of `stored` bytes cannot contain `count` bytes."""
    most = stored * _DEFLATE_RATIO if compressed else stored
    if count > most:
        rule = f"needs {count:,} bytes, but the file holds at most {most:,}: it is truncated, or its header is damaged"
        raise ScenarioError(Mistake(key, "", rule), source)


def exact_bytes(stream: IO[bytes], count: int, source: str, *, compressed: bool) -> bytes:
    """Read the rest of a stream, which must have exactly `count` bytes after decompression if `compressed`.

    Reads at most `count` + 1 bytes. Raises ScenarioError if the stream is shorter or longer, or is damaged.
    """
    reader: IO[bytes] = gzip.GzipFile(fileobj=stream) if compressed else stream  # type: ignore[assignment]
    try:
        data = reader.read(count)
        more = reader.read(1)  # at the end, gzip compares the checksum
    except (EOFError, OSError, zlib.error) as error:
        raise ScenarioError(f"is damaged or truncated: {error}", source) from None
    if len(data) < count:
        raise ScenarioError(f"is truncated: {len(data):,} bytes where its header says {count:,}", source)
    if more:
        raise ScenarioError(f"holds more than the {count:,} bytes that its header says", source)
    return data
