"""Content of any table file: that of the plane or of 3D, as the axes that the file names."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from needleplan.errors import Mistake, TableError
from needleplan.planning._plane_file import PLANE_AXES, PlaneContent, plane_content
from needleplan.planning._sealed_file import SealedBytes, read_sealed
from needleplan.planning._space_file import SPACE_AXES, SpaceContent, space_content
from needleplan.planning._space_places import exceeds_memory
from needleplan.planning._table_file import axes_text

if TYPE_CHECKING:
    from collections.abc import Callable

    import h5py

__all__ = ["read_content"]

# Function that returns the content of a file, by the names of its axes; the last ones are those of earlier versions.
_CONTENTS: dict[str, Callable[[h5py.File, SealedBytes], PlaneContent | SpaceContent]] = {
    PLANE_AXES: plane_content,
    SPACE_AXES: space_content,
    "slice, direction, y, z": space_content,
}


def read_content(
    path: str | os.PathLike[str],
    key: bytes | None = None,
    *,
    isolated: bool | None = None,
    mapped: bool | None = None,
) -> PlaneContent | SpaceContent:
    """Read a table, and verify its signature if `key` is given; `isolated` and errors as `read_sealed`.

    If `mapped`, 3D tables are mapped into memory, unless they are compressed; by default (None), if they need more than
    half of the available memory.
    """
    if mapped is None:
        with suppress(OSError, TypeError, ValueError):
            mapped = exceeds_memory((Path(path).stat().st_size // 7,))
    return read_sealed(path, _content, key, isolated=isolated, in_memory=not mapped)


def _content(file: h5py.File, source: SealedBytes) -> PlaneContent | SpaceContent:
    axes = axes_text(file)
    if axes not in _CONTENTS:
        raise TableError(Mistake("axes", axes, f'must be "{PLANE_AXES}" or "{SPACE_AXES}"'))
    return _CONTENTS[axes](file, source)
