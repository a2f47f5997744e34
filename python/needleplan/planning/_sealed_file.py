"""Sealed HDF5 files of policy tables, in the plane and in 3D: writing, reading, and checks before data are read.

The first 512 bytes are an HDF5 user block with the seal (`_seal.py`), which is verified before HDF5 parses the file.
Readers that ignore the seal, such as MATLAB's `h5read`, open the file like any other HDF5 file. A sealed file may come
from another program, so before data are read, their type, shape and place in the file must be those expected.
"""

from __future__ import annotations

import io
import os
from collections.abc import Callable, Container, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, TypeVar

import numpy as np

from needleplan.artifacts import path_text, whole_file, write_whole
from needleplan.errors import InputError, Mistake, TableError, reading
from needleplan.planning._seal import SEAL_BYTES, seal, seal_of_file, verify

if TYPE_CHECKING:
    import h5py
    from numpy.typing import NDArray

__all__ = [
    "SealedBytes",
    "compression",
    "foreign_datasets",
    "mapped",
    "read_sealed",
    "require_none",
    "sealed_file",
    "write_sealed",
]

_Content = TypeVar("_Content")

# Bytes of a chunk of a compressed table. HDF5 holds one chunk in memory; larger ones compress hardly better.
_CHUNK_BYTES = 2**24

# Level of gzip: level 4 takes 1.3 times the time for files that are 3 % smaller.
_COMPRESSION_LEVEL = 1

# Largest ratio by which DEFLATE can shrink data, a property of its format; files that claim more lack data.
_MOST_COMPRESSION = 1032

# Begin of the seals, with the SHA-256 of all other bytes, of files that libhdf5 reads without a crash: this process has
# written them, or a child process has tried them.
_harmless: set[bytes] = set()


def write_sealed(path: str | os.PathLike[str], fill: Callable[[h5py.File], None], key: bytes | None = None) -> None:
    """Write a file whose content `fill` writes, signed with `key` if given.

    Raises OutputError if it cannot be written; an existing file is then unchanged.
    """
    import h5py

    image = io.BytesIO()
    with h5py.File(image, "w", userblock_size=SEAL_BYTES) as file:
        fill(file)
    body = image.getbuffer()[SEAL_BYTES:]
    front = seal(body, key)
    write_whole(path, front, body)
    _harmless.add(_sealed_line(front))


@contextmanager
def sealed_file(path: str | os.PathLike[str], key: bytes | None = None) -> Iterator[Path]:
    """Yield a temporary file to fill from the end of the seal on; it is sealed, and becomes `path`, at the end.

    The file is never in memory as a whole. Raises the OutputErrors of `needleplan.artifacts.whole_file`.
    """
    with whole_file(path) as partial:
        yield partial
        with partial.open("r+b") as stream:
            front = seal_of_file(stream, key)
            stream.seek(0)
            stream.write(front)
    _harmless.add(_sealed_line(front))


@dataclass(frozen=True, eq=False)
class SealedBytes:
    """The content of a sealed file: a stream in memory or an open file on the disk, and its `size` in bytes."""

    stream: BinaryIO
    size: int

    def array(self, dataset: h5py.Dataset, kind: np.dtype[Any]) -> NDArray[Any]:
        """Return the data of a dataset of this type, as an array that cannot be written to.

        The array is mapped from a file on the disk, if the data are stored in one piece at a multiple of their size.
        """
        place = dataset.id.get_offset() if dataset.chunks is None else None
        on_disk = not isinstance(self.stream, io.BytesIO)
        if on_disk and place is not None and place % dataset.dtype.itemsize == 0 and dataset.dtype == kind:
            return mapped(self.stream, kind, place, dataset.shape)
        values = np.ascontiguousarray(dataset[()], kind)
        values.flags.writeable = False
        return values


def mapped(
    file: BinaryIO | str | os.PathLike[str], kind: np.dtype[Any], place: int, shape: tuple[int, ...]
) -> NDArray[Any]:
    """Return the array at the byte `place` of a file, mapped into memory; it cannot be written to."""
    return np.memmap(file, kind, "r", place, shape).view(np.ndarray)


def read_sealed(
    path: str | os.PathLike[str],
    content: Callable[[h5py.File, SealedBytes], _Content],
    key: bytes | None = None,
    *,
    isolated: bool | None = None,
    in_memory: bool = True,
) -> _Content:
    """Read a file with `content(file, bytes)`, and verify its signature if `key` is given.

    The file is first read into memory, where nothing can change it after it has been verified. If not `in_memory`, it
    is read piece by piece; whoever changes it in place afterwards changes the arrays of its content.

    If `isolated`, a child process tries the file first, because a crafted file may crash libhdf5. By default (None), a
    child process tries all files but those with a verified signature, and those whose bytes this process has written or
    tried before.

    Raises ChecksumError if bytes have changed or the signature is not that of the key, TableError if the file is not a
    complete table.
    """
    import h5py

    source = path_text(path, TableError, "a table file")
    with reading(path, TableError):
        stream: BinaryIO = io.BytesIO(Path(path).read_bytes()) if in_memory else Path(path).open("rb")  # noqa: SIM115
    with stream:
        _require_sealed(path, stream, key, isolated)
        try:
            with h5py.File(stream, "r") as file:
                return content(file, SealedBytes(stream, stream.seek(0, os.SEEK_END)))
        except TableError as error:
            raise type(error)(error.mistakes, source) from None
        except InputError as error:
            raise TableError(f"is sealed but does not hold a policy table: {error}", source) from error
        except Exception as error:  # h5py raises many types of exceptions for a file that another program has made
            raise TableError(f"is sealed but does not hold a policy table: {error}", source) from error


def _require_sealed(path: str | os.PathLike[str], stream: BinaryIO, key: bytes | None, isolated: bool | None) -> None:
    """Raise ChecksumError or TableError for an open file that is not sealed, or on which libhdf5 fails."""
    source = os.fspath(path)
    verify(stream, source, key)
    stream.seek(0)
    line = _sealed_line(stream.read(SEAL_BYTES))
    if key is None and line not in _harmless if isolated is None else isolated:
        from needleplan.artifacts.hdf5_guard import require_harmless  # 70 ms that planning does not need

        try:
            require_harmless(path)
        except InputError as error:
            raise TableError(error.mistakes, source) from None
        _harmless.add(line)


def require_none(mistakes: list[Mistake]) -> None:
    """Raise TableError if there are mistakes."""
    if mistakes:
        raise TableError(mistakes)


def compression(array: NDArray[Any]) -> dict[str, Any]:
    """Return the storage options of a compressed array: chunks of slices along the first axis, shuffled bytes, gzip."""
    slices = max(1, _CHUNK_BYTES // max(array[0].nbytes, 1))
    chunks = (min(slices, array.shape[0]), *array.shape[1:])
    return {"chunks": chunks, "shuffle": True, "compression": "gzip", "compression_opts": _COMPRESSION_LEVEL}


def foreign_datasets(
    file: h5py.File,
    wanted: Mapping[str, tuple[tuple[int, ...] | None, str]],
    size: int,
    compressible: Container[str] = (),
) -> Iterator[Mistake]:
    """Yield a mistake for each dataset that is not stored in this file of `size` bytes with the wanted shape and type.

    `wanted` holds shape (None: any) and kind of the type by name; `compressible` ones may be compressed. Without this
    check, HDF5 would read other files (external storage, links, virtual datasets), follow links in a circle, or
    allocate what the file only claims to hold.
    """
    import h5py

    for name, (expected, kind) in wanted.items():
        link = file.get(name, getlink=True)
        if not isinstance(link, h5py.HardLink) or file.get(name, getclass=True) is not h5py.Dataset:
            yield Mistake(name, "", "must be a dataset of the file, not a link or a group")
            continue
        dataset = file[name]
        plist = dataset.id.get_create_plist()
        compressed = plist.get_layout() == h5py.h5d.CHUNKED and name in compressible
        if (plist.get_layout() != h5py.h5d.CONTIGUOUS and not compressed) or dataset.external:
            yield Mistake(name, "", "must be stored in the file itself, in one piece or, as a table, compressed")
            continue
        shape = dataset.shape if expected is None else expected
        if dataset.shape != shape or len(dataset.shape) != len(shape) or dataset.dtype.kind != kind:
            yield Mistake(name, f"{dataset.dtype} {dataset.shape}", f"must have the shape {shape} of the scenario")
            continue
        length = dataset.size * dataset.dtype.itemsize
        if compressed:
            filters = {plist.get_filter(number)[0] for number in range(plist.get_nfilters())}
            if not filters <= {h5py.h5z.FILTER_SHUFFLE, h5py.h5z.FILTER_DEFLATE}:
                yield Mistake(name, "", "must be compressed by shuffle and gzip only")
            elif dataset.id.get_storage_size() * _MOST_COMPRESSION < length:
                yield Mistake(name, f"{dataset.shape}", "must be stored in the file itself: its data are not there")
            continue
        # Both are asked for: the offset of data that were never written is -1 after the user block, not None.
        if length and (dataset.id.get_storage_size() != length or dataset.id.get_offset() + length > size):
            yield Mistake(name, f"{dataset.shape}", "must be stored in the file itself: its data are not there")


def _sealed_line(data: bytes) -> bytes:
    return data[:SEAL_BYTES].partition(b"\n")[0]
