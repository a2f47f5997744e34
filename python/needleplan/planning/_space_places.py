"""Room for the tables of a 3D plan in a file, and the choice between memory and file.

A state needs 7 bytes: `values` 4, `policy` 1, `success` 2. The solver writes each slice to its place when it is
finished, and keeps the slices of one step only. The finished tables are mapped: the system loads the parts that are
read, and may drop them. Answers are the same, bit for bit.
"""

from __future__ import annotations

import errno
import math
import os
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from needleplan.errors import Mistake, OutputError
from needleplan.planning._sealed_file import mapped

if TYPE_CHECKING:
    import h5py
    from numpy.typing import NDArray

__all__ = ["SUCCESS_STEPS", "TYPES", "TablePlaces", "exceeds_memory", "made_places", "require_room", "temporary_places"]

SUCCESS_STEPS = 65535
"""Stored success of a certain success."""

TYPES: dict[str, np.dtype[Any]] = {
    "values": np.dtype(np.float32),
    "policy": np.dtype(np.uint8),
    "success": np.dtype(np.uint16),
}
"""Type of each table."""

# Share of the available memory up to which tables are kept there. While a file is read, its tables are there twice.
_SHARE = 0.5
# Room (bytes) for what is written to an HDF5 file after its tables.
_SLACK_BYTES = 2**16
# Errors of file systems that cannot reserve room; writing then finds a full disk.
_NO_RESERVING = (errno.EOPNOTSUPP, errno.EINVAL, errno.ENOSYS, errno.ENODEV)


@dataclass(frozen=True)
class TablePlaces:
    """A file with room for tables of a shape; `offsets` are the places of their first bytes, in order of `TYPES`."""

    path: Path
    shape: tuple[int, ...]
    offsets: tuple[int, int, int]

    @property
    def holes(self) -> list[tuple[int, int]]:
        """The first byte of each table, and the byte after its last one."""
        return [(place, place + math.prod(self.shape) * kind.itemsize) for place, kind in self._parts()]

    def reserve(self) -> None:
        """Let the file system reserve the room. Raises OSError if the disk has not enough."""
        if hasattr(os, "posix_fallocate"):
            with self.path.open("r+b") as stream:
                try:
                    os.posix_fallocate(stream.fileno(), 0, max(end for _, end in self.holes) + _SLACK_BYTES)
                except OSError as error:
                    if error.errno not in _NO_RESERVING:
                        raise

    def write(self, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Write whole tables. Raises OSError."""
        with self.path.open("r+b") as stream:
            for place, name in zip(self.offsets, TYPES, strict=True):
                stream.seek(place)
                for slice_ in arrays[name]:
                    stream.write(np.ascontiguousarray(slice_).data)

    def arrays(self, path: Path | None = None) -> dict[str, NDArray[Any]]:
        """Return the tables, mapped from the file, also after the file was renamed."""
        return {name: mapped(path or self.path, kind, place, self.shape)
                for name, (place, kind) in zip(TYPES, self._parts(), strict=True)}  # fmt: skip

    def _parts(self) -> Iterator[tuple[int, np.dtype[Any]]]:
        return zip(self.offsets, TYPES.values(), strict=True)


def made_places(file: h5py.File, path: Path, shape: tuple[int, ...]) -> TablePlaces:
    """Create contiguous datasets for the tables in an open HDF5 file at `path`, and return their places."""
    import h5py

    plist = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    plist.set_layout(h5py.h5d.CONTIGUOUS)
    plist.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)
    plist.set_fill_time(h5py.h5d.FILL_TIME_NEVER)
    space, places = h5py.h5s.create_simple(shape), []
    for name, kind in TYPES.items():
        dataset = h5py.h5d.create(file.id, name.encode(), h5py.h5t.py_create(kind), space, plist)
        places.append(dataset.get_offset())
    return TablePlaces(path, shape, (places[0], places[1], places[2]))


@contextmanager
def temporary_places(shape: tuple[int, ...]) -> Iterator[TablePlaces]:
    """Yield places in a file without a name after the context: the system removes it with the last array of it.

    The file is in the folder for temporary files (`TMPDIR`). Raises OutputError for an OSError in the context.
    """
    states, folder = math.prod(shape), tempfile.gettempdir()
    source = f"temporary file in {folder}"
    require_room(folder, 7 * states, source)
    try:
        descriptor, name = tempfile.mkstemp(prefix="needleplan-", suffix=".tables", dir=folder)
        os.close(descriptor)
        try:
            places = TablePlaces(Path(name), shape, (0, 6 * states, 4 * states))
            places.reserve()
            yield places
        finally:
            with suppress(OSError):
                Path(name).unlink()
    except OSError as error:
        rule = f"cannot be written: {error.strerror or error}; TMPDIR names another folder"
        raise OutputError(Mistake("", "", rule), source) from error


def require_room(folder: str | os.PathLike[str], needed_bytes: int, source: str) -> None:
    """Raise OutputError if the disk of a folder has less room than a file needs."""
    free = shutil.disk_usage(folder).free
    if free < needed_bytes:
        rule = f"cannot be written: it needs {needed_bytes / 1e9:.2f} GB, and the disk has {free / 1e9:.2f} GB left"
        raise OutputError(Mistake("", "", rule), source)


def exceeds_memory(shape: tuple[int, ...]) -> bool:
    """Return whether tables of a shape need more than half of the available memory."""
    return 7 * math.prod(shape) > _SHARE * _available_bytes()


def _available_bytes() -> float:
    """Return the memory that programs can take without swapping; infinity where the system does not tell.

    A limit of the control group, as containers have it, counts as the memory of the machine.
    """
    available = math.inf
    with suppress(OSError, ValueError, IndexError):
        lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
        available = 1024 * float(next(line.split()[1] for line in lines if line.startswith("MemAvailable:")))
    if available == math.inf:
        with suppress(AttributeError, OSError, ValueError):
            available = float(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    with suppress(OSError, ValueError):  # "max" is no number: no limit
        available = min(available, float(Path("/sys/fs/cgroup/memory.max").read_text(encoding="ascii")))
    return available
