"""Program of a child process that reads a foreign HDF5 file with libhdf5 (`hdf5_guard.py` starts it).

One damaged byte may make libhdf5 loop for ever, crash, or allocate all memory, and nothing in the same process can stop
it. This program therefore limits its own CPU time and memory, and its parent ends it if it takes too long.

Arguments: CPU time limit (s), memory limit (bytes), largest accepted length of a dataset, names of the number columns
and of the text columns, separated by commas. Standard input: the file. Standard output: the length of a JSON text (8
bytes, little-endian), the JSON text, and the numbers as 64-bit floats. The JSON text has `error`, or the names of the
`groups` and `columns` in the root, and `tables`: by group the `attributes` and the `columns`. A column has `stored`,
false if its data are in another file, and `values`: the index of its first number, its list of texts, or null if the
column is not read. The program imports nothing of needleplan, which would take longer than the reading.

With the argument `try PATH` after the limits, it only opens a file with all its datasets and attributes, and writes
nothing: its parent learns whether libhdf5 survives that.
"""

from __future__ import annotations

import io
import json
import sys
from typing import Any

__all__ = ["limit", "main", "read", "try_all"]

# Size (bytes) of contiguous data up to which they are read as a whole, and not their first and last element only.
_MOST_BYTES = 2**28


def limit(cpu_s: int, memory_bytes: int) -> None:
    """Limit the CPU time and the address space of this process, where the operating system can do so."""
    try:
        import resource
    except ImportError:  # Windows; the parent limits the time
        return
    for which, value, room in (
        (resource.RLIMIT_CPU, cpu_s, 1),
        (resource.RLIMIT_AS, memory_bytes, 0),
        (resource.RLIMIT_CORE, 0, 0),
    ):
        most = resource.getrlimit(which)[1]  # a limit that the user has set can only be lowered
        ends = value if most == resource.RLIM_INFINITY else min(value, most)
        resource.setrlimit(which, (ends, ends + room if most == resource.RLIM_INFINITY else min(ends + room, most)))


def read(content: bytes, most: int, numbers: list[str], texts: list[str]) -> tuple[dict[str, Any], list[bytes]]:
    """Return the JSON record and the numbers of an HDF5 file. Links to other places are ignored, as if absent."""
    import h5py

    blobs: list[bytes] = []

    def described(name: str, dataset: Any, length: int) -> dict[str, Any]:
        stored = not (dataset.is_virtual or dataset.external)
        shape, kind = dataset.shape, dataset.dtype.kind
        values: int | list[str] | None = None
        readable = stored and shape is not None and len(shape) == 1 and 0 <= shape[0] <= most and shape[0] == length
        if readable and name in numbers and kind in "fiu":
            values = sum(map(len, blobs)) // 8
            blobs.append(dataset[()].astype("<f8").tobytes())
        elif readable and name in texts and kind in "OSiu":
            values = [_text(value) for value in dataset[()].tolist()]
        return {"name": name, "shape": str(shape), "dimensions": -1 if shape is None else len(shape),
                "length": shape[0] if shape else -1, "type": str(dataset.dtype), "kind": kind, "stored": stored,
                "values": values}  # fmt: skip

    def group_of(group: Any) -> dict[str, Any]:
        found = {name: group[name] for name in hard(group) if isinstance(group[name], h5py.Dataset)}
        time = found.get("time_s")
        length = time.shape[0] if time is not None and time.shape else -1
        return {
            "attributes": {
                key: _text(group.attrs[key]) for key in ("trial", "role", "coordinate_frame") if key in group.attrs
            },
            "columns": [described(name, each, length) for name, each in found.items()],
        }

    def hard(group: Any) -> list[str]:
        return [name for name in group if isinstance(group.get(name, getlink=True), h5py.HardLink)]

    with h5py.File(io.BytesIO(content), "r") as file:
        members = [(name, file[name]) for name in hard(file)]
        groups = [name for name, each in members if isinstance(each, h5py.Group)]
        columns = [name for name, each in members if isinstance(each, h5py.Dataset)]
        if columns or not groups:
            return {"groups": groups, "columns": columns, "tables": {"": group_of(file)} if columns else {}}, blobs
        return {"groups": groups, "columns": [], "tables": {name: group_of(file[name]) for name in groups}}, blobs


def try_all(path: str) -> None:
    """Ask libhdf5 for every dataset in the root of a file, its attributes, its place and its data.

    Errors that libhdf5 reports are ignored: the parent meets them, too. Data that the file only claims to hold are not
    read.
    """
    import contextlib
    import os

    import h5py

    with contextlib.suppress(Exception), h5py.File(path, "r") as file:
        for each in [file, *(_dataset(file, name) for name in file)]:
            with contextlib.suppress(Exception):
                _ = [each.attrs[name] for name in each.attrs]
            with contextlib.suppress(Exception):
                length = each.size * each.dtype.itemsize
                contiguous = each.id.get_create_plist().get_layout() == h5py.h5d.CONTIGUOUS and not each.external
                if contiguous and each.id.get_storage_size() == length <= os.path.getsize(path):  # noqa: PTH202
                    first, last = (0,) * each.ndim, (-1,) * each.ndim
                    _ = each.id.get_offset(), (each[()] if length <= _MOST_BYTES else (each[first], each[last]))


def _dataset(file: Any, name: str) -> Any:
    """Return a dataset of the file itself; None for links, groups, and what cannot be opened."""
    import h5py

    try:
        hard = isinstance(file.get(name, getlink=True), h5py.HardLink)
        return file[name] if hard and file.get(name, getclass=True) is h5py.Dataset else None
    except Exception:
        return None


def _text(value: object) -> str:
    """Return a text of a file, which HDF5 stores as bytes."""
    return value.decode("utf-8", errors="replace") if isinstance(value, bytes) else str(value)


def main(arguments: list[str], content: bytes) -> bytes:
    """Return the output of the program."""
    try:
        record, blobs = read(content, int(arguments[0]), arguments[1].split(","), arguments[2].split(","))
    except MemoryError:
        record, blobs = {"error": "reading it takes more memory than a file of this size may need"}, []
    except Exception as error:  # h5py raises many types of exceptions for damaged files
        record, blobs = {"error": str(error)}, []
    head = json.dumps(record).encode()
    return len(head).to_bytes(8, "little") + head + b"".join(blobs)


if __name__ == "__main__":
    limit(int(sys.argv[1]), int(sys.argv[2]))
    if sys.argv[3] == "try":
        try_all(sys.argv[4])
        sys.exit()
    sys.stdout.buffer.write(main(sys.argv[3:], sys.stdin.buffer.read()))
