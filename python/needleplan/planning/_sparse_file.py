"""A file in memory that holds only the pages which were written: an HDF5 file without the data of its large datasets.

HDF5 makes the file and changes it in memory. On a full disk libhdf5 would fail late, with objects that it cannot close;
`write_to` fails like any other write.
"""

from __future__ import annotations

import io
import os
from typing import TYPE_CHECKING, BinaryIO

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer, WriteableBuffer

__all__ = ["SparseFile"]

_PAGE_BYTES = 2**16


class SparseFile(io.RawIOBase):
    """A binary file in memory; bytes that were never written are zero, and take no memory."""

    def __init__(self) -> None:
        self._pages: dict[int, bytearray] = {}
        self._at = self._size = 0

    def readable(self) -> bool:
        """Return True."""
        return True

    def writable(self) -> bool:
        """Return True."""
        return True

    def seekable(self) -> bool:
        """Return True."""
        return True

    def seek(self, offset: int, whence: int = os.SEEK_SET, /) -> int:
        """Move to an offset (bytes), which may be beyond the end, and return the offset."""
        self._at = offset + {os.SEEK_SET: 0, os.SEEK_CUR: self._at, os.SEEK_END: self._size}[whence]
        return self._at

    def tell(self) -> int:
        """Return the present offset (bytes)."""
        return self._at

    def truncate(self, size: int | None = None, /) -> int:
        """Set the size of the file (bytes; default: the present offset), and return it; the offset does not change."""
        self._size = self._at if size is None else size
        return self._size

    def readinto(self, buffer: WriteableBuffer, /) -> int:
        """Read from the present place on, and return the number of bytes."""
        view = memoryview(buffer).cast("B")
        count = max(0, min(len(view), self._size - self._at))
        done = 0
        while done < count:
            page, place = divmod(self._at, _PAGE_BYTES)
            length = min(count - done, _PAGE_BYTES - place)
            content = self._pages.get(page)
            view[done : done + length] = content[place : place + length] if content else bytes(length)
            self._at, done = self._at + length, done + length
        return count

    def write(self, data: ReadableBuffer, /) -> int:
        """Write at the present place, and return the number of bytes."""
        view = memoryview(data).cast("B")
        done = 0
        while done < len(view):
            page, place = divmod(self._at, _PAGE_BYTES)
            length = min(len(view) - done, _PAGE_BYTES - place)
            self._pages.setdefault(page, bytearray(_PAGE_BYTES))[place : place + length] = view[done : done + length]
            self._at, done = self._at + length, done + length
        self._size = max(self._size, self._at)
        return done

    def write_to(self, stream: BinaryIO, holes: list[tuple[int, int]]) -> None:
        """Copy the written bytes to the same offsets of `stream`, which gets the size of this file.

        The bytes in `holes` are skipped. Each hole is a pair (begin, end) of offsets; `end` is excluded.
        """
        stream.truncate(self._size)
        for page, data in sorted(self._pages.items()):
            begin, end = page * _PAGE_BYTES, min((page + 1) * _PAGE_BYTES, self._size)
            for low, high in [*sorted(holes), (self._size, self._size)]:
                if begin < min(low, end):
                    stream.seek(begin)
                    stream.write(data[begin - page * _PAGE_BYTES : min(low, end) - page * _PAGE_BYTES])
                begin = max(begin, high)
