"""Files of policy tables: HDF5 with a checksum (seal) in front.

The first 512 bytes are an HDF5 user block. It holds the seal: the format, the length of the rest of the file and its
SHA-256, padded with zeros. The seal is verified before HDF5 parses the file, so changed bytes are always detected.
Readers that ignore the seal, such as MATLAB's `h5read`, open the file like any other HDF5 file.

Contiguous datasets follow: `values`, `policy` and `success` [x, y, heading, bevel] with their units and SHA-256, the
axes `x_mm`, `y_mm`, `heading_rad`, `bevel`, and `order`. The attributes of the root hold the text and the digest of the
scenario, the digest of the table, and the numbers of `Stats`. MATLAB shows the axes in reverse: [bevel, heading, y, x].
"""

from __future__ import annotations

import io
import os
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from needleplan.artifacts import digest, version, write_whole
from needleplan.errors import ChecksumError, InputError, Mistake, TableError
from needleplan.planning._lattice import Stats, Status
from needleplan.scenario import Scenario

if TYPE_CHECKING:
    import h5py
    import numpy as np
    from numpy.typing import NDArray

__all__ = ["FORMAT", "TABLES", "Content", "read", "write"]

# First word of a file: format and version.
FORMAT = "needleplan.table/1"

# Size (bytes) of the seal; the HDF5 user block must have 512 bytes or a larger power of two.
_SEAL_BYTES = 512
_HDF5 = b"\x89HDF\r\n\x1a\n"
# Description and unit of every table.
TABLES = {
    "values": ("expected cost from the state on, optimal", "cost"),
    "policy": ("0: insert, 1: rotate by half a turn, then insert", "1"),
    "success": ("probability of reaching the target under the policy", "1"),
}


@dataclass(frozen=True)
class Content:
    """The content of a table file."""

    values: NDArray[np.float32]
    policy: NDArray[np.uint8]
    success: NDArray[np.float32]
    stats: Stats
    scenario: Scenario


def write(path: str | os.PathLike[str], content: Content, table_digest: str) -> None:
    """Write a table file. Raises OutputError if it cannot be written; an existing file is then unchanged."""
    import h5py

    image = io.BytesIO()
    with h5py.File(image, "w", userblock_size=_SEAL_BYTES) as file:
        _fill(file, content, table_digest)
    body = image.getbuffer()[_SEAL_BYTES:]
    write_whole(path, _seal(body), body)


def read(path: str | os.PathLike[str]) -> Content:
    """Read a table. Raises ChecksumError if bytes have changed, TableError if the file is not a complete table."""
    import h5py

    if not isinstance(path, str | os.PathLike):
        raise TableError(Mistake("path", repr(path), "must be the path of a table file"))
    source = os.fspath(path)
    try:
        data = Path(path).read_bytes()
    except (OSError, ValueError) as error:
        reason = f"cannot be read: {getattr(error, 'strerror', None) or error}"
        raise TableError(reason, source) from error
    _verify(data, source)
    try:
        with h5py.File(io.BytesIO(data), "r") as file:
            return _content(file)
    except TableError as error:
        raise TableError(error.mistakes, source) from None
    except (OSError, KeyError, ValueError, TypeError, AttributeError, InputError) as error:
        raise TableError(f"is sealed but does not hold a policy table: {error}", source) from error


def _seal(body: memoryview) -> bytes:
    return f"{FORMAT} {len(body)} bytes {digest(body)}\n".encode().ljust(_SEAL_BYTES, b"\0")


def _verify(data: bytes, source: str) -> None:
    words = data[:_SEAL_BYTES].split(b"\n")[0].split(b" ")
    if words[0] != FORMAT.encode() or len(words) != 4 or not words[1].isdigit():
        if words[0].startswith(b"needleplan.table/") and words[0] != FORMAT.encode():
            name = words[0].decode(errors="replace")
            raise TableError(Mistake("format", name, f"another version; this needleplan reads {FORMAT}"), source)
        kind = "an HDF5 file, but not a sealed policy table" if data.startswith(_HDF5) else "not a policy table"
        raise TableError(f"is {kind}: it must begin with {FORMAT}", source)
    expected, found = int(words[1]), len(data) - _SEAL_BYTES
    if found < expected:
        raise TableError(f"is truncated: {max(found, 0):,} of {expected:,} bytes are there", source)
    if data[:_SEAL_BYTES] != _seal(memoryview(data)[_SEAL_BYTES:]):
        raise ChecksumError("has been altered since it was written: its SHA-256 is not that of its seal", source)


def _fill(file: h5py.File, content: Content, table_digest: str) -> None:
    scenario = content.scenario
    root: dict[str, Any] = {
        "format": FORMAT,
        "made_by": f"needleplan {version()}",
        "title": scenario.title.replace("\0", " "),
        "scenario": scenario.to_toml(),
        "scenario_digest": scenario.digest,
        "digest": table_digest,
        "axes": "x, y, heading, bevel",
        "origin_mm": (0.0, 0.0),
        "spacing_mm": scenario.grid.spacing_mm,
        **{name: value for name, value in asdict(content.stats).items() if name != "order"},
    }
    root["status"] = str(content.stats.status)
    file.attrs.update(root)
    for name, (description, unit) in TABLES.items():
        array = getattr(content, name)
        file.create_dataset(name, data=array)
        file[name].attrs.update({"description": description, "units": unit, "sha256": digest(array.data)})
    axes = {"x_mm": (scenario.x_mm, "mm"), "y_mm": (scenario.y_mm, "mm"), "heading_rad": (scenario.headings_rad, "rad")}
    for name, (axis, unit) in {**axes, "bevel": ((-1, 1), "1")}.items():
        file.create_dataset(name, data=axis)
        file[name].attrs["units"] = unit
    file.create_dataset("order", data=content.stats.order, dtype="uint32")
    file["order"].attrs["description"] = "partitions ix * py + iy in the order of their first processing"


def _require_units(file: h5py.File) -> None:
    """Raise TableError if the units in the file differ from the units of this package."""
    units = {name: unit for name, (_, unit) in TABLES.items()} | {"x_mm": "mm", "y_mm": "mm", "heading_rad": "rad"}
    mistakes = [
        Mistake(f"{name}.units", str(file[name].attrs.get("units", "")), f'must be "{unit}"')
        for name, unit in units.items() if file[name].attrs.get("units") != unit
    ]  # fmt: skip
    if mistakes:
        raise TableError(mistakes)


def _content(file: h5py.File) -> Content:
    _require_units(file)
    tables = {name: file[name][()] for name in TABLES}
    names = [each.name for each in fields(Stats) if each.name != "order"]
    # Tables of older versions have no bound on the success.
    numbers: dict[str, Any] = {
        name: file.attrs[name] for name in names if name != "success_error_bound" or name in file.attrs
    }
    plain = {name: getattr(value, "item", lambda value=value: value)() for name, value in numbers.items()}
    plain["status"] = Status(plain["status"])
    stats = Stats(**plain, order=tuple(file["order"][()].tolist()))
    return Content(**tables, stats=stats, scenario=Scenario.from_toml(file.attrs["scenario"]))
