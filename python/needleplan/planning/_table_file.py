"""Files of policy tables: HDF5 with a checksum (seal) in front (`_sealed_file.py`).

Datasets follow: `values`, `policy` and `success` [x, y, heading, bevel] with their units and SHA-256, the axes `x_mm`,
`y_mm`, `heading_rad`, `bevel`, and `order`. They are contiguous; in a compressed file, the three tables are chunks of
DEFLATE (gzip) with shuffled bytes, which HDF5 and MATLAB read without a plugin.

The attributes of the root hold the text and the digest of the scenario, the digest of the table, and the numbers of
`Stats`. MATLAB shows the axes in reverse: [bevel, heading, y, x].

Before data are read, their type, shape and place in the file must be those that the scenario requires; afterwards, all
digests, units, axes and numbers must agree.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import asdict, dataclass, fields
from typing import TYPE_CHECKING, Any

import numpy as np

from needleplan.artifacts import digest, version
from needleplan.errors import ChecksumError, Mistake, TableError
from needleplan.planning._lattice import Stats, Status
from needleplan.planning._seal import FORMAT
from needleplan.planning._sealed_file import (
    SealedBytes,
    compression,
    foreign_datasets,
    read_sealed,
    require_none,
    write_sealed,
)
from needleplan.scenario import Scenario

if TYPE_CHECKING:
    import h5py
    from numpy.typing import NDArray

__all__ = ["TABLES", "Content", "read", "table_digest", "write"]

# Description and unit of every table.
TABLES = {
    "values": ("expected cost from the state on, optimal", "cost"),
    "policy": ("0: insert, 1: rotate by half a turn, then insert, 2: insert straight", "1"),
    "success": ("probability of reaching the target under the policy", "1"),
}
_TYPES = {"values": np.float32, "policy": np.uint8, "success": np.float32}
_RESEALED = "the file has been altered and sealed again"


@dataclass(frozen=True)
class Content:
    """The content of a table file."""

    values: NDArray[np.float32]
    policy: NDArray[np.uint8]
    success: NDArray[np.float32]
    stats: Stats
    scenario: Scenario


def table_digest(scenario_digest: str, array_digests: list[str]) -> str:
    """Return the digest of a table from the digests of its scenario and of `values`, `policy` and `success`."""
    return digest("\n".join([scenario_digest, *array_digests]))


def write(
    path: str | os.PathLike[str],
    content: Content,
    its_digest: str,
    key: bytes | None = None,
    *,
    compressed: bool = False,
) -> None:
    """Write a table file, signed with `key` if given.

    Raises OutputError if it cannot be written; an existing file is then unchanged.
    """
    write_sealed(path, lambda file: _fill(file, content, its_digest, compressed), key)


def read(path: str | os.PathLike[str], key: bytes | None = None, *, isolated: bool | None = None) -> Content:
    """Read a table, and verify its signature if `key` is given; `isolated` and errors as `read_sealed`."""
    return read_sealed(path, _content, key, isolated=isolated)


def _fill(file: h5py.File, content: Content, its_digest: str, compressed: bool) -> None:
    scenario = content.scenario
    root: dict[str, Any] = {
        "format": FORMAT,
        "made_by": f"needleplan {version()}",
        "title": scenario.title.replace("\0", " "),
        "scenario": scenario.to_toml(),
        "scenario_digest": scenario.digest,
        "digest": its_digest,
        "axes": "x, y, heading, bevel",
        "origin_mm": (0.0, 0.0),
        "spacing_mm": scenario.grid.spacing_mm,
        **{name: value for name, value in asdict(content.stats).items() if name != "order"},
    }
    root["status"] = str(content.stats.status)
    file.attrs.update(root)
    for name, (description, unit) in TABLES.items():
        array = getattr(content, name)
        file.create_dataset(name, data=array, **(compression(array) if compressed else {}))
        file[name].attrs.update({"description": description, "units": unit, "sha256": digest(array.data)})
    for name, (axis, unit) in _axes(scenario).items():
        file.create_dataset(name, data=axis)
        file[name].attrs["units"] = unit
    file.create_dataset("order", data=content.stats.order, dtype="uint32")
    file["order"].attrs["description"] = "partitions ix * py + iy in the order of their first processing"


def _axes(scenario: Scenario) -> dict[str, tuple[Any, str]]:
    """Return the points and the unit of each axis."""
    lengths = {"x_mm": (scenario.x_mm, "mm"), "y_mm": (scenario.y_mm, "mm")}
    return {**lengths, "heading_rad": (scenario.headings_rad, "rad"), "bevel": (np.array([-1, 1]), "1")}


def _content(file: h5py.File, source: SealedBytes) -> Content:
    text = file.attrs["scenario"]
    if not isinstance(text, str):
        raise TableError(Mistake("scenario", type(text).__name__, "must be a text"))
    scenario = Scenario.from_toml(text)
    axes = _axes(scenario)
    wanted: dict[str, tuple[tuple[int, ...], str]] = {
        **{name: (scenario.shape, np.dtype(kind).kind) for name, kind in _TYPES.items()},
        **{name: (points.shape, points.dtype.kind) for name, (points, _) in axes.items()},
    }
    require_none(list(foreign_datasets(file, {**wanted, "order": (None, "u")}, source.size, compressible=TABLES)))
    require_none(list(_other_units(file)))
    tables = {name: file[name][()] for name in TABLES}
    for name, expected in (("spacing_mm", scenario.grid.spacing_mm), ("origin_mm", (0.0, 0.0))):
        if np.asarray(file.attrs[name]).tolist() != list(expected):
            raise TableError(Mistake(name, str(file.attrs[name]), f"must be {list(expected)}, as in the scenario"))
    require_none([
        Mistake(name, "", f"must hold the axis of the scenario, from {points[0]:g} to {points[-1]:g}")
        for name, (points, _) in axes.items()
        if not np.allclose(file[name][()], points, rtol=1e-9, atol=1e-9)
    ])  # fmt: skip
    _require_digests(file, text, tables)
    names = [each.name for each in fields(Stats) if each.name != "order"]
    # Tables of older versions have no bound on the success.
    numbers: dict[str, Any] = {
        name: file.attrs[name] for name in names if name != "success_error_bound" or name in file.attrs
    }
    plain = {name: getattr(value, "item", lambda value=value: value)() for name, value in numbers.items()}
    require_none([
        Mistake(name, repr(value), "must be a number")
        for name, value in plain.items()
        if name != "status" and (isinstance(value, bool) or not isinstance(value, int | float) or value != value)
    ])  # fmt: skip
    plain["status"] = Status(plain["status"])
    stats = Stats(**plain, order=tuple(file["order"][()].tolist()))
    return Content(**tables, stats=stats, scenario=scenario)


def _other_units(file: h5py.File) -> Iterator[Mistake]:
    """Yield a mistake for each dataset whose unit differs from the unit of this package."""
    units = {name: unit for name, (_, unit) in TABLES.items()} | {"x_mm": "mm", "y_mm": "mm", "heading_rad": "rad"}
    for name, unit in units.items():
        found = file[name].attrs.get("units")
        if found != unit:
            yield Mistake(f"{name}.units", str(found or ""), f'must be "{unit}"')


def _require_digests(file: h5py.File, text: str, tables: dict[str, Any]) -> None:
    """Raise ChecksumError if a digest in the file is not that of the scenario's text, an array or the whole table."""
    arrays = {name: digest(np.ascontiguousarray(array).data) for name, array in tables.items()}
    wrong = [name for name, found in arrays.items() if file[name].attrs["sha256"] != found]
    if file.attrs["scenario_digest"] != digest(text):
        wrong.append("scenario")
    if not wrong and file.attrs["digest"] != table_digest(digest(text), [*arrays.values()]):
        wrong.append("table")
    if wrong:
        raise ChecksumError([Mistake(name, "", f"its SHA-256 is not the stored one: {_RESEALED}") for name in wrong])
