"""Table files in the plane (`_table_file.py`): tables [x, y, heading, bevel], the numbers of `Stats`, and `order`.

The datasets are contiguous; in a compressed file, the three tables are chunks of DEFLATE (gzip) with shuffled bytes,
which HDF5 and MATLAB read without a plugin.
"""

from __future__ import annotations

import os
from dataclasses import asdict, dataclass, fields
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from needleplan.artifacts import digest
from needleplan.errors import Mistake, TableError
from needleplan.planning._lattice import Stats, Status
from needleplan.planning._sealed_file import SealedBytes, compression, foreign_datasets, require_none, write_sealed
from needleplan.planning._table_file import (
    TABLE_NAMES,
    Axes,
    add_axes,
    add_root,
    add_tables,
    array_digests,
    require_axes,
    require_digests,
    scenario_text,
)
from needleplan.scenario import Scenario

if TYPE_CHECKING:
    import h5py
    from numpy.typing import NDArray

__all__ = ["PLANE_AXES", "TABLES", "PlaneContent", "plane_content", "write_plane"]

PLANE_AXES = "x, y, heading, bevel"

# Description and unit of every table.
TABLES = {
    "values": ("expected cost from the state on, optimal", "cost"),
    "policy": ("0: insert, 1: rotate by half a turn, then insert, 2: insert straight", "1"),
    "success": ("probability of reaching the target under the policy", "1"),
}
_TYPES = {"values": np.float32, "policy": np.uint8, "success": np.float32}


@dataclass(frozen=True)
class PlaneContent:
    """The content of a table file in the plane."""

    axes: ClassVar = PLANE_AXES
    values: NDArray[np.float32]
    policy: NDArray[np.uint8]
    success: NDArray[np.float32]
    stats: Stats
    scenario: Scenario


def write_plane(
    path: str | os.PathLike[str], content: PlaneContent, key: bytes | None = None, *, compressed: bool = False
) -> None:
    """Write a table file, signed with `key` if given.

    Raises OutputError if it cannot be written; an existing file is then unchanged.
    """
    write_sealed(path, lambda file: _fill(file, content, compressed), key)


def _fill(file: h5py.File, content: PlaneContent, compressed: bool) -> None:
    scenario = content.scenario
    add_root(file, scenario, PLANE_AXES)
    numbers = {name: value for name, value in asdict(content.stats).items() if name != "order"}
    numbers["status"] = str(content.stats.status)
    file.attrs.update({"origin_mm": (0.0, 0.0), "spacing_mm": scenario.grid.spacing_mm, **numbers})
    arrays = {name: getattr(content, name) for name in TABLE_NAMES}
    for name, array in arrays.items():
        file.create_dataset(name, data=array, **(compression(array) if compressed else {}))
    add_tables(file, TABLES, scenario.digest, array_digests(arrays))
    add_axes(file, _axes(scenario))
    file.create_dataset("order", data=content.stats.order, dtype="uint32")
    file["order"].attrs["description"] = "partitions ix * py + iy in the order of their first processing"


def _axes(scenario: Scenario) -> Axes:
    """Return the points and the unit of each axis."""
    lengths = {"x_mm": (scenario.x_mm, "mm"), "y_mm": (scenario.y_mm, "mm")}
    return {**lengths, "heading_rad": (scenario.headings_rad, "rad"), "bevel": (np.array([-1, 1]), "1")}


def plane_content(file: h5py.File, source: SealedBytes) -> PlaneContent:
    """Return the content of an open table file in the plane. Raises TableError or ChecksumError if it is wrong."""
    text = scenario_text(file)
    scenario = Scenario.from_toml(text)
    axes = _axes(scenario)
    wanted: dict[str, tuple[tuple[int, ...], str]] = {
        **{name: (scenario.shape, np.dtype(kind).kind) for name, kind in _TYPES.items()},
        **{name: (points.shape, points.dtype.kind) for name, (points, _) in axes.items()},
    }
    require_none(list(foreign_datasets(file, {**wanted, "order": (None, "u")}, source.size, compressible=TABLES)))
    require_axes(file, axes, TABLES)
    tables = {name: file[name][()] for name in TABLES}
    for name, expected in (("spacing_mm", scenario.grid.spacing_mm), ("origin_mm", (0.0, 0.0))):
        if np.asarray(file.attrs[name]).tolist() != list(expected):
            raise TableError(Mistake(name, str(file.attrs[name]), f"must be {list(expected)}, as in the scenario"))
    require_digests(file, digest(text), array_digests(tables))
    return PlaneContent(**tables, stats=_stats(file), scenario=scenario)


def _stats(file: h5py.File) -> Stats:
    names = [field.name for field in fields(Stats) if field.name != "order"]
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
    return Stats(**plain, order=tuple(file["order"][()].tolist()))
