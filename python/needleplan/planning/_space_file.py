"""Table files in 3D (`_table_file.py`): tables [x, direction, y, z], the grid that was planned in, and `direction`.

The grid [x, y, z] has `tissues`, `clearance_mm`, `entry`, and finer `voxels` and `possible`; `direction` holds the unit
vectors, [direction, 3]. The datasets are contiguous; in a compressed file, the tables, `voxels` and `possible` are
chunks of DEFLATE (gzip) with shuffled bytes. Further attributes of the root: the place of the frame in RAS, and the
radii of the tissues. The text of the scenario is that of an anatomy file.

The volume itself is not needed to use a table, and is not in the file.

A file is made in place: first everything but the tables, with room for them, then the tables, piece by piece and in any
order (`TablePlaces`), then their digests and the seal. So a table may be larger than memory.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from needleplan.anatomy import AnatomyFile, AnatomyGrid, SpaceFrame, SpaceScenario, Sphere, TargetBody
from needleplan.artifacts import digest, is_device
from needleplan.errors import ChecksumError, Mistake, OutputError, ScenarioError, TableError
from needleplan.planning._lattice import Progress, compiled_call
from needleplan.planning._seal import SEAL_BYTES
from needleplan.planning._sealed_file import (
    SealedBytes,
    compression,
    foreign_datasets,
    require_none,
    sealed_file,
    write_sealed,
)
from needleplan.planning._space_estimates import ESTIMATE_COLUMNS, are_estimates
from needleplan.planning._space_places import (
    TYPES,
    TablePlaces,
    made_places,
    require_room,
    temporary_places,
)
from needleplan.planning._space_problem import space_of
from needleplan.planning._sparse_file import SparseFile
from needleplan.planning._table_file import (
    Axes,
    add_axes,
    add_root,
    add_tables,
    array_digests,
    axes_text,
    require_axes,
    require_digests,
    scenario_text,
)

if TYPE_CHECKING:
    import h5py
    from numpy.typing import NDArray

    from needleplan import _ppvi
    from needleplan._ppvi_results import SpaceReport

__all__ = ["SPACE_AXES", "SpaceContent", "solved_in_file", "space_content", "write_space"]

SPACE_AXES = "x, direction, y, z"

_TABLES = {
    "values": ("expected cost from the state on, optimal", "cost"),
    "policy": ("number of the roll angle; the number of roll angles: straight step", "1"),
    "success": ("probability of reaching the target under the policy, in 1/65535", "1/65535"),
}
# Estimates of success that are known, if there are any.
_ESTIMATES = "estimates"
_ESTIMATES_TEXT = "success from entries, by executions with the seed 0 in the continuous model, with its 95 % interval"
_GRID = {
    "tissues": ("number of the radius in radii_mm", "1", np.uint8),
    "clearance_mm": ("distance to obstacles without margin", "mm", np.float32),
    "entry": ("0, or number of the voxel of the grid point where a needle enters; 1: at it", "1", np.uint16),
}
# On grids that are finer by a whole number along each axis.
_FINER = {
    "voxels": ("0 free, 1 target, 2 obstacle, 3 outside", "1", np.uint8),
    "possible": ("for a proof; 0 passable, 1 target, 2 blocked; 4 is added in the entry region", "1", np.uint8),
}
# Largest size of an axis of the grid, so that a product of sizes cannot overflow.
_MOST_POINTS = 100_000
_MOST_REFINEMENT = 8  # of voxels between two grid points along an axis
# Data of at least so many bytes begin at a multiple of so many bytes, so that they can be mapped into memory.
_ALIGNED_FROM, _ALIGNMENT = 1024, 64


@dataclass(frozen=True, eq=False)
class SpaceContent:
    """The content of a table file: what was planned, compiled, and solved, and the SHA-256 of each table, if known.

    `estimates` has the rows of the estimates of success, shape (n, 10) (`_space_estimates.py`).
    """

    axes: ClassVar[str] = SPACE_AXES
    scenario: SpaceScenario
    space: _ppvi.Space
    solved: _ppvi.SolvedSpace
    digests: dict[str, str] | None
    estimates: NDArray[np.float64] | None = None


def write_space(
    path: str | os.PathLike[str], content: SpaceContent, key: bytes | None = None, *, compressed: bool = False
) -> None:
    """Write a table file, signed with `key` if given.

    Raises OutputError if it cannot be written, or the table is not complete.
    """
    report = content.solved.report()
    tables = {name: getattr(content.solved, name) for name in TYPES}
    digests = content.digests or array_digests(tables)
    _require_complete(report, path)
    if compressed or is_device(path):

        def fill(file: h5py.File) -> None:
            _fill(file, content.scenario, content.space, compressed=compressed)
            for name, array in tables.items():
                file.create_dataset(name, data=array, **(compression(array) if compressed else {}))
            _complete(file, content, digests, report)

        write_sealed(path, fill, key)
        return
    with _new_file(path, content.scenario, content.space, key) as new:
        new.places.write(tables)
        new.complete(content, digests, report)


def solved_in_file(
    scenario: SpaceScenario,
    space: _ppvi.Space,
    path: str | os.PathLike[str] | None,
    key: bytes | None = None,
    *,
    estimates: Callable[[SpaceContent], NDArray[np.float64]],
    threads: int | None = None,
    progress: Progress | None = None,
) -> SpaceContent:
    """Solve a scenario, and write each slice to the table file `path` when it is finished; None: a temporary file.

    `estimates` returns the rows of the estimates of success that the file shall have.

    Raises OutputError if the file cannot be written, or the solve was ended before it was complete; a file that was
    there before is then unchanged.
    """

    def solve(places: TablePlaces) -> SpaceReport:
        offsets = list(places.offsets)
        report = compiled_call(ScenarioError, space.solve_to, places.path, offsets, threads=threads, progress=progress)
        _require_complete(report, path or "table")
        return report

    if path is None:
        with temporary_places(tuple(space.shape)) as places:
            report, tables, digests, rows = solve(places), places.arrays(), None, None
    else:
        with _new_file(path, scenario, space, key) as new:
            report, tables = solve(new.places), new.places.arrays()
            digests = array_digests(tables)
            solved = SpaceContent(scenario, space, space.restore(**tables, seconds=report["seconds"]), digests)
            rows = estimates(solved)
            new.complete(replace(solved, estimates=rows), digests, report)
        tables = new.places.arrays(Path(path))
    return SpaceContent(scenario, space, space.restore(**tables, seconds=report["seconds"]), digests, rows)


@dataclass(frozen=True, eq=False)
class _NewFile:
    """A new file: the places of its tables, and everything else in memory, where HDF5 changes it."""

    places: TablePlaces
    image: SparseFile

    def complete(self, content: SpaceContent, digests: Mapping[str, str], report: SpaceReport) -> None:
        """Write everything else, with the digests of the tables, which are in their places. Raises OSError."""
        import h5py

        with h5py.File(self.image, "r+") as file:
            _complete(file, content, digests, report)
        with self.places.path.open("r+b") as stream:
            self.image.write_to(stream, self.places.holes)


@contextmanager
def _new_file(
    path: str | os.PathLike[str], scenario: SpaceScenario, space: _ppvi.Space, key: bytes | None
) -> Iterator[_NewFile]:
    """Yield a new file, which is sealed and becomes `path` at the end of the context."""
    import h5py

    if is_device(path):
        rule = "cannot be written: tables that do not fit into the memory need a file, not a device or folder"
        raise OutputError(Mistake("", "", rule), os.fspath(path))
    shape, image = tuple(space.shape), SparseFile()
    with sealed_file(path, key) as partial:
        options = {"userblock_size": SEAL_BYTES, "alignment_threshold": _ALIGNED_FROM, "alignment_interval": _ALIGNMENT}
        with h5py.File(image, "w", **options) as file:
            _fill(file, scenario, space)
            places = made_places(file, partial, shape)
        require_room(partial.parent, image.seek(0, os.SEEK_END), os.fspath(path))
        places.reserve()
        yield _NewFile(places, image)


def _require_complete(report: SpaceReport, path: str | os.PathLike[str]) -> None:
    if report["status"] != "converged":
        rule = f"was not written: the solve was not complete (status {report['status']})"
        raise OutputError(Mistake("", "", rule), os.fspath(path))


def _fill(file: h5py.File, scenario: SpaceScenario, space: _ppvi.Space, *, compressed: bool = False) -> None:
    """Write everything but the tables."""
    grid, frame = scenario.grid, scenario.grid.frame
    add_root(file, scenario, SPACE_AXES)
    file.attrs.update(
        {
            "origin_mm": frame.origin_mm,
            "frame_axes": frame.axes,
            "spacing_mm": frame.spacing_mm,
            "radii_mm": grid.radii_mm,
        }
    )
    for name, (description, unit, kind) in {**_GRID, **_FINER}.items():
        array = np.ascontiguousarray(getattr(grid, name), kind)
        file.create_dataset(name, data=array, **(compression(array) if compressed and name in _FINER else {}))
        file[name].attrs.update({"description": description, "units": unit, "sha256": digest(array.data)})
    if grid.target.ball is None:
        description = "1: voxel of the target; that of a point p of the frame (mm) is floor(rows (p, 1))"
        file.create_dataset("target", data=grid.target.inside)
        file["target"].attrs.update(
            {
                "description": description,
                "units": "1",
                "rows": grid.target.rows,
                "sha256": digest(grid.target.inside.data),
            }
        )
    add_axes(file, _axes(frame, space))


def _axes(frame: SpaceFrame, space: _ppvi.Space) -> Axes:
    """Return the points and the unit of each axis."""
    lengths = zip("xyz", frame.shape, strict=True)
    points = {f"{name}_mm": (np.arange(count) * frame.spacing_mm, "mm") for name, count in lengths}
    return {**points, "direction": (np.asarray(space.tangents()), "1")}


def _complete(file: h5py.File, content: SpaceContent, digests: Mapping[str, str], report: SpaceReport) -> None:
    """Write the digests of the tables, which are there, how the solve went, and the estimates of success."""
    file.attrs.update({"status": report["status"], "seconds": float(report["seconds"])})
    add_tables(file, _TABLES, content.scenario.digest, digests)
    if content.estimates is not None and len(content.estimates):
        rows = np.ascontiguousarray(content.estimates, np.float64)
        file.create_dataset(_ESTIMATES, data=rows)
        about = {"description": _ESTIMATES_TEXT, "columns": ", ".join(ESTIMATE_COLUMNS), "sha256": digest(rows.data)}
        file[_ESTIMATES].attrs.update(about)


def space_content(file: h5py.File, source: SealedBytes) -> SpaceContent:
    """Return the content of an open 3D table file. Raises TableError or ChecksumError if it is wrong."""
    settings = AnatomyFile.from_toml(scenario_text(file))
    finer = dict.fromkeys(("entry", *_FINER), (None, "u"))
    require_none(list(foreign_datasets(file, finer, source.size, compressible=_FINER)))
    shape = file["entry"].shape
    if len(shape) != 3 or not all(0 < count <= _MOST_POINTS for count in shape):
        raise TableError(Mistake("entry", str(shape), "must have three axes"))
    for name in _FINER:
        if file[name].shape not in [tuple(r * count for count in shape) for r in range(1, _MOST_REFINEMENT + 1)]:
            rule = f"must have 1 to {_MOST_REFINEMENT} times the points of the grid along each axis, {shape}"
            raise TableError(Mistake(name, str(file[name].shape), rule))
    require_none(list(foreign_datasets(file, {name: (shape, np.dtype(kind).kind)
                                              for name, (_, _, kind) in _GRID.items()}, source.size)))  # fmt: skip
    grid = _grid(file, settings, (int(shape[0]), int(shape[1]), int(shape[2])), source.size)
    scenario = SpaceScenario(settings, grid)
    space = space_of(scenario)
    # Files of earlier versions have no axes.
    axes = _axes(grid.frame, space) if axes_text(file) == SPACE_AXES else {}
    wanted = {name: (points.shape, points.dtype.kind) for name, (points, _) in axes.items()}
    wanted |= {name: (tuple(space.shape), kind.kind) for name, kind in TYPES.items()}
    require_none(list(foreign_datasets(file, wanted, source.size, compressible=TYPES)))
    require_axes(file, axes, _TABLES)
    tables = {name: source.array(file[name], kind) for name, kind in TYPES.items()}
    solved = compiled_call(TableError, space.restore, **tables, seconds=float(file.attrs["seconds"]))
    digests = array_digests(tables)
    require_digests(file, scenario.digest, digests)
    return SpaceContent(scenario, space, solved, digests, _estimates(file, source.size))


def _estimates(file: h5py.File, size: int) -> NDArray[np.float64] | None:
    """Return the rows of the estimates of success, None if the file has none. Raises TableError or ChecksumError."""
    if _ESTIMATES not in file:
        return None
    require_none(list(foreign_datasets(file, {_ESTIMATES: (None, "f")}, size)))
    rows = np.ascontiguousarray(file[_ESTIMATES][()], np.float64)
    if digest(rows.data) != file[_ESTIMATES].attrs.get("sha256"):
        raise ChecksumError(Mistake(_ESTIMATES, "", "its SHA-256 is not the stored one: the file has been altered"))
    if not are_estimates(rows):
        columns = ", ".join(ESTIMATE_COLUMNS)
        rule = f"must have rows of {columns}, with the success from 0 to 1 in its interval, one of each pose"
        raise TableError(Mistake(_ESTIMATES, str(rows.shape), rule))
    return rows


def _target(file: h5py.File, settings: AnatomyFile, frame: SpaceFrame, size: int) -> TargetBody:
    """Return the target. Raises TableError."""
    ball = settings.anatomy.target
    if isinstance(ball, Sphere):
        return TargetBody.of_ball(frame, ball)
    if "target" not in file:
        raise TableError(Mistake("target", "", "is missing: an earlier version wrote the file; plan the anatomy again"))
    require_none(list(foreign_datasets(file, {"target": (None, "u")}, size)))
    rows = np.array(file["target"].attrs["rows"], np.float64)
    if file["target"].ndim != 3 or rows.shape != (3, 4) or not np.isfinite(rows).all() or not file["target"].size:
        raise TableError(Mistake("target", str(file["target"].shape), "must have three axes and 3 x 4 finite rows"))
    return TargetBody(None, rows, np.ascontiguousarray(file["target"][()], np.uint8))


def _grid(file: h5py.File, settings: AnatomyFile, shape: tuple[int, int, int], size: int) -> AnatomyGrid:
    """Return the grid of a file whose datasets have been checked. Raises TableError if its numbers are impossible."""
    axes, origin = np.array(file.attrs["frame_axes"], np.float64), np.array(file.attrs["origin_mm"], np.float64)
    mistakes = []
    if axes.shape != (3, 3) or not np.allclose(axes @ axes.T, np.eye(3), atol=1e-6):
        mistakes.append(Mistake("frame_axes", "", "must be three perpendicular unit vectors"))
    if origin.shape != (3,) or not np.isfinite(origin).all():
        mistakes.append(Mistake("origin_mm", "", "must be three finite numbers"))
    spacing = float(file.attrs["spacing_mm"])
    if spacing not in settings.lattice.spacings_mm:
        rule = f"must be lattice.spacing_mm of the settings, or without it one of {settings.lattice.spacings_mm}"
        mistakes.append(Mistake("spacing_mm", f"{spacing:g}", rule))
    radii = tuple(float(number) for number in file.attrs["radii_mm"])
    expected = (settings.needle.curvature_radius_mm, *(tissue.radius_mm for tissue in settings.anatomy.curvature))
    if radii != expected:
        mistakes.append(Mistake("radii_mm", str(radii), f"must be those of the settings, {expected}"))
    arrays = {name: np.ascontiguousarray(file[name][()], kind) for name, (_, _, kind) in _GRID.items()}
    arrays |= {name: np.ascontiguousarray(file[name][()], np.uint8) for name in _FINER}
    voxels = arrays["voxels"]
    if voxels.max() > 3 or not (voxels == 1).any() or not arrays["entry"].any():
        mistakes.append(Mistake("voxels", "", "must be from 0 to 3, with a target and an entry region"))
    if arrays["tissues"].max() >= len(expected):
        mistakes.append(Mistake("tissues", f"{arrays['tissues'].max()}", "must be numbers of radii_mm"))
    most = (voxels.shape[0] // shape[0]) ** 3
    if arrays["entry"].max(initial=0) > most:
        mistakes.append(Mistake("entry", str(arrays["entry"].max()), f"must be at most {most}"))
    require_none(mistakes)
    frame = SpaceFrame(origin, axes, spacing, shape)
    return AnatomyGrid(
        frame,
        voxels,
        arrays["possible"],
        arrays["clearance_mm"],
        arrays["entry"],
        arrays["tissues"],
        radii,
        _target(file, settings, frame, size),
    )
