"""Files of policy tables in space: HDF5 with a checksum (seal) in front (`_sealed_file.py`).

Contiguous datasets: `values`, `policy` and `success` [slice, direction, y, z] with their units and SHA-256; the grid
[x, y, z] that was planned in: `codes`, `tissues`, `clearance_mm`, `entry`; and `tangents` [direction, 3]. In a
compressed file, the first three are chunks of DEFLATE (gzip) with shuffled bytes. The attributes of the root hold the
settings as the text of an anatomy file, the place of the frame in RAS, the radii of the tissues, and the digests of
scenario and table. MATLAB shows the axes in reverse.

The volume itself is not needed to use a table, and is not in the file.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from needleplan.anatomy import AnatomyFile, AnatomyGrid, SpaceFrame, SpaceScenario
from needleplan.artifacts import digest, version
from needleplan.errors import ChecksumError, Mistake, TableError
from needleplan.planning._lattice import compiled_call
from needleplan.planning._seal import SPACE_FORMAT
from needleplan.planning._sealed_file import compression, foreign_datasets, read_sealed, require_none, write_sealed
from needleplan.planning._space_problem import space_of

if TYPE_CHECKING:
    import h5py
    from numpy.typing import NDArray

    from needleplan import _ppvi

__all__ = ["SpaceContent", "read_space", "space_digest", "write_space"]

_TABLES = {
    "values": ("expected cost from the state on, optimal", "cost", np.float32),
    "policy": ("number of the roll angle; the number of roll angles: straight step", "1", np.uint8),
    "success": ("probability of reaching the target under the policy, in 1/65535", "1/65535", np.uint16),
}
_GRID = {
    "codes": ("0 free, 1 target, 2 obstacle, 3 outside", "1", np.uint8),
    "tissues": ("number of the radius in radii_mm", "1", np.uint8),
    "clearance_mm": ("distance to obstacles without margin", "mm", np.float32),
    "entry": ("1: in the entry region", "1", np.uint8),
}
# Largest size of an axis of the grid, so that a product of sizes cannot overflow.
_MOST_POINTS = 100_000
_RESEALED = "the file has been altered and sealed again"


@dataclass(frozen=True, eq=False)
class SpaceContent:
    """The content of a table file: what was planned, compiled, and solved."""

    scenario: SpaceScenario
    space: _ppvi.Space
    solved: _ppvi.SolvedSpace


def space_digest(scenario: SpaceScenario, arrays: Iterable[NDArray[Any]]) -> str:
    """Return the digest of a table: of the scenario's digest, and of `values`, `policy` and `success`."""
    return digest("\n".join([scenario.digest, *(digest(array.data) for array in arrays)]))


def write_space(
    path: str | os.PathLike[str],
    content: SpaceContent,
    its_digest: str,
    status: str,
    key: bytes | None = None,
    *,
    compressed: bool = False,
) -> None:
    """Write a table file, signed with `key` if given. Raises OutputError if it cannot be written."""
    write_sealed(path, lambda file: _fill(file, content, its_digest, status, compressed), key, SPACE_FORMAT)


def read_space(path: str | os.PathLike[str], key: bytes | None = None, *, isolated: bool | None = None) -> SpaceContent:
    """Read a table, and verify its signature if `key` is given; `isolated` and errors as `read_sealed`."""
    return read_sealed(path, _content, key, isolated=isolated, form=SPACE_FORMAT)


def _fill(file: h5py.File, content: SpaceContent, its_digest: str, status: str, compressed: bool) -> None:
    scenario, grid, frame = content.scenario, content.scenario.grid, content.scenario.grid.frame
    file.attrs.update(
        {
            "format": SPACE_FORMAT,
            "made_by": f"needleplan {version()}",
            "title": scenario.title.replace("\0", " "),
            "anatomy": scenario.to_toml(),
            "scenario_digest": scenario.digest,
            "digest": its_digest,
            "axes": "slice, direction, y, z",
            "origin_mm": frame.origin_mm,
            "frame_axes": frame.axes,
            "spacing_mm": frame.spacing_mm,
            "radii_mm": grid.radii_mm,
            "status": status,
            "seconds": float(content.solved.report()["seconds"]),
        }
    )
    arrays: dict[str, Any] = {name: getattr(content.solved, name) for name in _TABLES}
    arrays |= {name: np.ascontiguousarray(getattr(grid, name), kind) for name, (_, _, kind) in _GRID.items()}
    for name, (description, unit, _) in (_TABLES | _GRID).items():
        options = compression(arrays[name]) if compressed and name in _TABLES else {}
        file.create_dataset(name, data=arrays[name], **options)
        file[name].attrs.update({"description": description, "units": unit, "sha256": digest(arrays[name].data)})
    file.create_dataset("tangents", data=np.asarray(content.space.tangents()))


def _content(file: h5py.File, size: int) -> SpaceContent:
    text = file.attrs["anatomy"]
    if not isinstance(text, str):
        raise TableError(Mistake("anatomy", type(text).__name__, "must be a text"))
    settings = AnatomyFile.from_toml(text)
    require_none(list(foreign_datasets(file, {"codes": (None, "u")}, size)))
    shape = file["codes"].shape
    if len(shape) != 3 or not all(0 < each <= _MOST_POINTS for each in shape):
        raise TableError(Mistake("codes", str(shape), "must have three axes"))
    require_none(list(foreign_datasets(file, {name: (shape, np.dtype(kind).kind)
                                              for name, (_, _, kind) in _GRID.items()}, size)))  # fmt: skip
    grid = _grid(file, settings, (int(shape[0]), int(shape[1]), int(shape[2])))
    scenario = SpaceScenario(settings, grid)
    space = space_of(scenario)
    wanted = {name: (tuple(space.shape), np.dtype(kind).kind) for name, (_, _, kind) in _TABLES.items()}
    require_none(list(foreign_datasets(file, wanted, size, compressible=_TABLES)))
    tables = {name: np.ascontiguousarray(file[name][()], kind) for name, (_, _, kind) in _TABLES.items()}
    flat = {name: array.ravel() for name, array in tables.items()}
    solved = compiled_call(TableError, space.restore, **flat, seconds=float(file.attrs["seconds"]))
    wrong = [name for name, array in tables.items() if file[name].attrs["sha256"] != digest(array.data)]
    digests = {"scenario_digest": scenario.digest, "digest": space_digest(scenario, tables.values())}
    wrong += [name for name, found in digests.items() if file.attrs[name] != found]
    if wrong:
        raise ChecksumError([Mistake(name, "", f"its SHA-256 is not the stored one: {_RESEALED}") for name in wrong])
    return SpaceContent(scenario, space, solved)


def _grid(file: h5py.File, settings: AnatomyFile, shape: tuple[int, int, int]) -> AnatomyGrid:
    """Return the grid of a file whose datasets have been checked. Raises TableError if its numbers are impossible."""
    axes, origin = np.array(file.attrs["frame_axes"], np.float64), np.array(file.attrs["origin_mm"], np.float64)
    mistakes = []
    if axes.shape != (3, 3) or not np.allclose(axes @ axes.T, np.eye(3), atol=1e-6):
        mistakes.append(Mistake("frame_axes", "", "must be three perpendicular unit vectors"))
    if origin.shape != (3,) or not np.isfinite(origin).all():
        mistakes.append(Mistake("origin_mm", "", "must be three finite numbers"))
    spacing = float(file.attrs["spacing_mm"])
    if spacing != settings.lattice.spacing_mm:
        rule = f"must be lattice.spacing_mm of the settings, {settings.lattice.spacing_mm:g}"
        mistakes.append(Mistake("spacing_mm", f"{spacing:g}", rule))
    radii = tuple(float(each) for each in file.attrs["radii_mm"])
    expected = (settings.needle.curvature_radius_mm, *(each.radius_mm for each in settings.anatomy.curvature))
    if radii != expected:
        mistakes.append(Mistake("radii_mm", str(radii), f"must be those of the settings, {expected}"))
    arrays = {name: np.ascontiguousarray(file[name][()], kind) for name, (_, _, kind) in _GRID.items()}
    if arrays["codes"].max() > 3 or not (arrays["codes"] == 1).any() or not arrays["entry"].any():
        mistakes.append(Mistake("codes", "", "must be from 0 to 3, with a target and an entry region"))
    if arrays["tissues"].max() >= len(expected):
        mistakes.append(Mistake("tissues", f"{arrays['tissues'].max()}", "must be numbers of radii_mm"))
    require_none(mistakes)
    frame = SpaceFrame(origin, axes, spacing, shape)
    return AnatomyGrid(
        frame, arrays["codes"], arrays["clearance_mm"], arrays["entry"].astype(bool), arrays["tissues"], radii
    )
