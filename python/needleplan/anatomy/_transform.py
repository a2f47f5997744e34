"""Files of linear transforms as ITK and 3D Slicer read them: text (.tfm) and HDF5 (.h5).

ITK has LPS coordinates, where the first two axes are opposite to RAS, and its transforms resample: they map points of
the result to points of what is moved. 3D Slicer inverts a transform when it reads it, so that it moves what is below it
in its tree of data.
"""

from __future__ import annotations

import io
import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from needleplan.errors import InputError, Mistake, OutputError

__all__ = ["TRANSFORM_ENDINGS", "pose_matrix", "require_transform_name", "transform_bytes"]

TRANSFORM_ENDINGS = (".tfm", ".h5")
"""Endings of the names of transform files."""

_KIND = "AffineTransform_double_3_3"
_LPS = np.diag([-1.0, -1.0, 1.0, 1.0])

# Largest deviation of a rotation matrix from orthogonality.
_SQUARE = 1e-6


def pose_matrix(position_mm: Sequence[float], direction: Sequence[float]) -> NDArray[np.float64]:
    """Return the rigid motion that moves a needle model to a pose; its tip is at the origin, and it points along +x.

    Parameters
    ----------
    position_mm : sequence of float
        Place of the tip (mm), length 3.
    direction : sequence of float
        Direction of the insertion, length 3. The other two axes are any that are perpendicular to it.

    Returns
    -------
    numpy.ndarray
        Homogeneous matrix, shape (4, 4).

    Examples
    --------
    >>> from needleplan.anatomy import pose_matrix
    >>> pose_matrix((10.0, 0.0, 5.0), (0.0, 0.0, 2.0))[:3, 0].tolist()
    [0.0, 0.0, 1.0]
    """
    along = np.asarray(direction, float) / np.linalg.norm(direction)
    # The axis of space that is furthest from the direction gives the first perpendicular.
    across = np.cross(along, np.eye(3)[np.argmin(np.abs(along))])
    across /= np.linalg.norm(across)
    matrix = np.eye(4)
    matrix[:3, :3] = np.column_stack([along, across, np.cross(along, across)])
    matrix[:3, 3] = position_mm
    return matrix


def transform_bytes(to_ras: ArrayLike, ending: str) -> bytes:
    """Return the bytes of a transform file for 3D Slicer and ITK.

    Parameters
    ----------
    to_ras : array
        Homogeneous matrix of a rigid motion, shape (4, 4), from the coordinates of an object to RAS (mm).
    ending : str
        `.tfm` or `.h5`.

    Returns
    -------
    bytes
        The file. Under this transform, 3D Slicer shows the object at its place in RAS.

    Raises
    ------
    InputError
        If the matrix is not a rigid motion.

    Examples
    --------
    >>> from needleplan.anatomy import pose_matrix, transform_bytes
    >>> print(transform_bytes(pose_matrix((10.0, 0.0, 5.0), (1.0, 0.0, 0.0)), ".tfm").decode().splitlines()[2])
    Transform: AffineTransform_double_3_3
    """
    matrix = np.asarray(to_ras, float)
    turn = matrix[:3, :3]
    if matrix.shape != (4, 4) or not np.allclose(turn @ turn.T, np.eye(3), atol=_SQUARE):
        raise InputError(Mistake("to_ras", "", "must be the matrix of a rigid motion, shape (4, 4)"))
    resampling = _LPS @ np.linalg.inv(matrix) @ _LPS
    numbers = [*resampling[:3, :3].ravel().tolist(), *resampling[:3, 3].tolist()]
    return _text(numbers) if ending == ".tfm" else _hdf5(numbers)


def require_transform_name(option: str, file: str | os.PathLike[str] | None) -> None:
    """Raise OutputError if the name of a transform file has a wrong ending.

    Parameters
    ----------
    option : str
        Command line option that gave the name, for messages.
    file : str or path
        Name of the file. None is accepted.

    Raises
    ------
    OutputError
        The name does not end in .tfm or .h5.

    Examples
    --------
    >>> from needleplan.anatomy import require_transform_name
    >>> require_transform_name("--transform", "entry.tfm")
    """
    if file is not None and Path(file).suffix.lower() not in TRANSFORM_ENDINGS:
        raise OutputError(Mistake(option, os.fspath(file), f"must end in {' or '.join(TRANSFORM_ENDINGS)}"))


def _text(numbers: Sequence[float]) -> bytes:
    words = " ".join(repr(number) for number in numbers)
    lines = ("#Insight Transform File V1.0", "#Transform 0", f"Transform: {_KIND}", f"Parameters: {words}")
    return "\n".join([*lines, "FixedParameters: 0 0 0", ""]).encode()


def _hdf5(numbers: Sequence[float]) -> bytes:
    import h5py

    image = io.BytesIO()
    text = h5py.string_dtype("ascii")  # ITK reads no other texts
    with h5py.File(image, "w") as file:
        file.create_dataset("ITKVersion", data=["5.0.0"], dtype=text)
        file.create_dataset("HDFVersion", data=[h5py.version.hdf5_version], dtype=text)
        group = file.create_group("TransformGroup/0")
        group.create_dataset("TransformType", data=[_KIND], dtype=text)
        group.create_dataset("TransformFixedParameters", data=np.zeros(3))
        group.create_dataset("TransformParameters", data=np.asarray(numbers))
    return image.getvalue()
