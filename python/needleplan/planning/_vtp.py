"""VTP files (VTK XML PolyData): polylines and points with numbers, for ParaView, PyVista and 3D Slicer.

Positions are RAS mm. The field `SPACE` says so, as 3D Slicer writes and reads it; other programs ignore it. Arrays are
base64 with their length in front (VTK file formats, "XML file formats", inline binary).
"""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

__all__ = ["vtp_bytes"]

_KINDS = {np.dtype(np.float64): "Float64", np.dtype(np.int64): "Int64"}


def vtp_bytes(
    lines_mm: Sequence[ArrayLike],
    points_mm: ArrayLike,
    of_lines: Mapping[str, ArrayLike],
    of_points: Mapping[str, ArrayLike],
) -> bytes:
    """Return a VTP file with single points and polylines, in RAS mm.

    Parameters
    ----------
    lines_mm : sequence of array
        Points of each line, shape (n, 3).
    points_mm : array
        Single points, shape (m, 3).
    of_lines : mapping
        Numbers of each line by name; they become numbers of the cells, NaN for single points.
    of_points : mapping
        Numbers of each single point by name, likewise, NaN for lines.

    Returns
    -------
    bytes
        The file.
    """
    single = np.asarray(points_mm, np.float64).reshape(-1, 3)
    lines = [np.asarray(line_mm, np.float64).reshape(-1, 3) for line_mm in lines_mm]
    places = np.concatenate([single, *lines]) if lines else single
    lengths = np.array([len(line) for line in lines], np.int64)
    numbers = {}
    for name in (*of_points, *(of_line for of_line in of_lines if of_line not in of_points)):
        # The cells of a PolyData are in the order of vertices, then lines.
        first = np.asarray(of_points.get(name, np.full(len(single), np.nan)), np.float64)
        second = np.asarray(of_lines.get(name, np.full(len(lines), np.nan)), np.float64)
        numbers[name] = np.concatenate([first, second])
    vertices = _cells(np.arange(len(single)), np.arange(1, len(single) + 1))
    polylines = _cells(np.arange(len(single), len(places)), np.cumsum(lengths))
    cells = "".join(_array(name, values) for name, values in numbers.items())
    text = (
        '<?xml version="1.0"?>\n'
        '<VTKFile type="PolyData" version="1.0" byte_order="LittleEndian" header_type="UInt64">\n'
        "<PolyData>\n<FieldData>\n"
        '<DataArray type="String" Name="SPACE" NumberOfTuples="1" format="ascii">82 65 83 0</DataArray>\n'
        f'</FieldData>\n<Piece NumberOfPoints="{len(places)}" NumberOfVerts="{len(single)}" '
        f'NumberOfLines="{len(lines)}" NumberOfStrips="0" NumberOfPolys="0">\n'
        f"<CellData>\n{cells}</CellData>\n<Points>\n{_array('points', places, 3)}</Points>\n"
        f"<Verts>\n{vertices}</Verts>\n<Lines>\n{polylines}</Lines>\n</Piece>\n</PolyData>\n</VTKFile>\n"
    )
    return text.encode()


def _cells(points: NDArray[np.int64], ends: NDArray[np.int64]) -> str:
    return _array("connectivity", points.astype(np.int64)) + _array("offsets", ends.astype(np.int64))


def _array(name: str, values: NDArray[np.float64] | NDArray[np.int64], components: int = 1) -> str:
    from xml.sax.saxutils import quoteattr  # imports http.client and email: 15 ms that planning does not need

    data = np.ascontiguousarray(values).astype(values.dtype.newbyteorder("<")).tobytes()
    coded = base64.b64encode(len(data).to_bytes(8, "little") + data).decode()
    return (
        f'<DataArray type="{_KINDS[np.dtype(values.dtype)]}" Name={quoteattr(name)} '
        f'NumberOfComponents="{components}" format="binary">{coded}</DataArray>\n'
    )
