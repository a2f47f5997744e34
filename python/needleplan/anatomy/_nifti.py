"""NIfTI-1 and NIfTI-2 files (.nii, .nii.gz), by way of nibabel.

The sform gives the orientation if its code is positive, else the qform, as in nibabel. A file in which both codes are 0
does not state its orientation and is refused; so is a file whose sform and qform contradict each other.
"""

from __future__ import annotations

import gzip
import io
import logging
import re
import warnings
import zlib
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import numpy as np

from needleplan.anatomy._volume import LabelVolume, counted_bytes, exact_bytes, require_size, whole_labels
from needleplan.errors import Mistake, ScenarioError

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["extension_names", "image_bytes", "nifti_bytes", "read_nifti", "read_nifti_vectors"]

# Sizes (bytes) of the headers of NIfTI-1 and NIfTI-2, which are also their first number.
_HEADER_1, _HEADER_2 = 348, 540
# Largest space (bytes) between header and voxels, for extensions.
_LONGEST_EXTENSIONS = 2**24
# Codes of the units of length.
_UNKNOWN_UNIT, _MM, _UNITS = 0, 2, {1: "meter", 3: "micron"}
# Label of an extension: its number and its name.
_NAME = re.compile(rb'<Label\b[^>]*?\bKey="(\d{1,5})"[^>]*>(?:<!\[CDATA\[)?([^<>\]]{1,200})')
# Codes of the intent of vectors, with the signs that turn their axes into RAS, and number of components of a vector.
_VECTOR_AXES, _COMPONENTS = {1007: (-1, -1, 1), 1006: (1, 1, 1)}, 3
# Largest contradiction of sform and qform, in voxels.
_CONTRADICTION = 0.1


def read_nifti(path: Path) -> LabelVolume:
    """Return the labels in a NIfTI file. Raises ScenarioError if it is damaged or contains no labels with a place."""
    values, affine, _ = _read(path)
    return LabelVolume(whole_labels(values.reshape(values.shape[:3]), str(path)), affine, source=str(path))


def read_nifti_vectors(path: Path) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
    """Return displacements in RAS mm, shape (n, 3, ni, nj, nk), and the matrix from their voxels to RAS mm.

    The file has n fields: its shape is (ni, nj, nk, n, 3), or (ni, nj, nk, 3) for one. The intent says the axes of the
    vectors: `NIFTI_INTENT_VECTOR` LPS, as ITK and ANTs write it, `NIFTI_INTENT_DISPVECT` RAS, which ITK converts since
    5.4 (`ConvertRASDisplacementVectors`). Raises ScenarioError if the file is damaged or has no such vectors.
    """
    values, affine, intent = _read(path, vectors=True)
    if intent not in _VECTOR_AXES:
        rule = "must be 1007 (vectors in LPS, as ITK writes them) or 1006 (displacements in RAS)"
        raise ScenarioError(Mistake("intent_code", f"{intent}", rule), str(path))
    whole = np.asarray(values, np.float32).reshape(*values.shape[:3], -1, _COMPONENTS)
    signs = np.array(_VECTOR_AXES[intent], np.float32)
    return np.asarray(np.moveaxis(whole * signs, (3, 4), (0, 1)), np.float32), affine


def _read(path: Path, *, vectors: bool = False) -> tuple[NDArray[np.generic], NDArray[np.float64], int]:
    """Return the values of a volume, or of fields of vectors, the matrix from voxels to RAS mm, and the intent."""
    source, compressed = str(path), path.name.lower().endswith(".gz")
    try:
        stored = path.stat().st_size
        with path.open("rb") as stream:
            header = _header(_start(stream, compressed, source), source)
            shape, itemsize = header.get_data_shape(), header.get_data_dtype().itemsize
            if vectors and not (len(shape) in (4, 5) and shape[-1] == _COMPONENTS):
                rule = f"must be voxels x voxels x voxels x {_COMPONENTS}, or with the phases before the last axis"
                raise ScenarioError(Mistake("dim", " x ".join(map(str, shape)), rule), source)
            each = itemsize * int(np.prod(shape[3:])) if vectors else itemsize
            voxels = counted_bytes(shape[:3] if vectors else shape, each, "dim", source)
            offset = float(header["vox_offset"])
            if not int(header["sizeof_hdr"]) <= offset <= _LONGEST_EXTENSIONS:
                raise ScenarioError(Mistake("vox_offset", f"{offset:g}", "must lie behind the header"), source)
            require_size(int(offset) + voxels, stored, compressed, "dim", source)
            affine = _affine(header, shape, source)
            stream.seek(0)
            data = exact_bytes(stream, int(offset) + voxels, source, compressed=compressed)
    except OSError as error:
        raise ScenarioError(f"cannot be read: {error.strerror}", source) from None
    return _values(header, data, source), affine, int(header["intent_code"])


def extension_names(path: Path) -> dict[str, int]:
    """Return the label numbers by name from an extension of a NIfTI file, as TotalSegmentator writes it.

    The extension is an XML text with elements `Label`, whose attribute `Key` is the number. Without it the result is
    empty.
    """
    if not path.name.lower().endswith((".nii", ".nii.gz")):
        return {}
    import nibabel

    try:
        with np.errstate(all="ignore"), warnings.catch_warnings(action="ignore"):
            extensions: Any = getattr(nibabel.load(path).header, "extensions", ())
    except Exception as error:  # a damaged extension fails in its own way
        raise ScenarioError(f"has a damaged NIfTI extension: {error}", str(path)) from None
    texts = [extension.get_content() for extension in extensions]
    texts = [text if isinstance(text, bytes) else str(text).encode() for text in texts]
    matches = [match for text in texts for match in _NAME.findall(text)]
    return {name.decode("utf-8", "replace").strip(): int(key) for key, name in matches}


def nifti_bytes(volume: LabelVolume) -> bytes:
    """Return a volume as a compressed NIfTI-1 file, the same bytes for the same volume."""
    return image_bytes(volume.labels.astype(np.uint8) if volume.labels.max() < 256 else volume.labels, volume.affine)


def image_bytes(values: NDArray[np.generic], affine: NDArray[np.float64], description: str = "") -> bytes:
    """Return an array as a compressed NIfTI-1 file.

    Parameters
    ----------
    values : numpy.ndarray
        Voxels, shape (ni, nj, nk).
    affine : numpy.ndarray
        Matrix from voxel indices to RAS coordinates (mm), shape (4, 4).
    description : str, optional
        Text of at most 80 ASCII characters.

    Returns
    -------
    bytes
    """
    import nibabel

    image = nibabel.Nifti1Image(values, affine)
    image.set_sform(affine, 1)
    image.set_qform(affine, 1)
    image.header.set_xyzt_units("mm")
    image.header["descrip"] = description.encode("ascii")
    return gzip.compress(image.to_bytes(), mtime=0)


def _start(stream: IO[bytes], compressed: bool, source: str) -> bytes:
    reader: Any = gzip.GzipFile(fileobj=stream) if compressed else stream
    try:
        return bytes(reader.read(_HEADER_2))
    except (EOFError, OSError, zlib.error) as error:
        raise ScenarioError(f"is damaged or truncated: {error}", source) from None


def _header(start: bytes, source: str) -> Any:
    """Return the header in the first bytes of a file."""
    import nibabel

    sizes = {int.from_bytes(start[:4], order) for order in ("little", "big")} if len(start) >= _HEADER_1 else set()
    kind: Any = nibabel.Nifti2Header if _HEADER_2 in sizes else nibabel.Nifti1Header
    length = _HEADER_2 if _HEADER_2 in sizes else _HEADER_1
    if not sizes & {_HEADER_1, _HEADER_2} or len(start) < length:
        raise ScenarioError("is not a NIfTI file: it does not begin with a header of 348 or 540 bytes", source)
    logger = logging.getLogger("nibabel.global")
    before, logger.disabled = logger.disabled, True  # mistakes are raised, and must not be printed too
    try:
        with np.errstate(all="ignore"):
            header = kind(start[:length], check=True)
            header.get_data_dtype(), header.get_data_shape(), header.get_slope_inter(), header.get_best_affine()
    except Exception as error:  # a damaged header fails in any of these in its own way
        raise ScenarioError(f"has a damaged NIfTI header: {error}", source) from None
    finally:
        logger.disabled = before
    if bytes(header["magic"].tobytes())[:3] not in (b"n+1", b"n+2"):
        raise ScenarioError("must be a single NIfTI file (.nii): this header belongs to a pair .hdr, .img", source)
    return header


def _affine(header: Any, shape: tuple[int, ...], source: str) -> np.ndarray:
    """Return the matrix from voxels to RAS mm. Raises ScenarioError if the header does not state it."""
    unit = int(header["xyzt_units"]) & 7
    if unit not in (_UNKNOWN_UNIT, _MM):
        raise ScenarioError(Mistake("xyzt_units", _UNITS.get(unit, f"{unit}"), "must be mm"), source)
    sform, qform = int(header["sform_code"]) > 0, int(header["qform_code"]) > 0
    if not (sform or qform):
        rule = "sform_code and qform_code are 0: the file does not say how its axes lie in the body (left or right?)"
        raise ScenarioError(Mistake("orientation", "", f"is missing: {rule}; export it with an orientation"), source)
    with np.errstate(all="ignore"):
        affine = np.asarray(header.get_best_affine(), np.float64)
    if sform and qform and np.isfinite(affine).all():  # LabelVolume refuses an affine that is not finite
        with np.errstate(all="ignore"):
            other = np.asarray(header.get_qform(), np.float64)
            if not np.isfinite(other).all():
                raise ScenarioError(Mistake("qform", "", "must be finite, or have the code 0"), source)
            corners = np.array([[i, j, k, 1] for i in (0, 1) for j in (0, 1) for k in (0, 1)]) * [*shape[:3], 1]
            apart = abs((affine - other) @ corners.T).max()
            least = np.linalg.norm(affine[:3, :3], axis=0).min()
        if not apart <= _CONTRADICTION * least:  # also true for NaN, as by an overflow
            rule = f"sform and qform place voxels up to {apart:.3g} mm apart; remove one of them (code 0)"
            raise ScenarioError(Mistake("orientation", "", rule), source)
    return affine


def _values(header: Any, data: bytes, source: str) -> np.ndarray:
    """Return the voxel values, shape (ni, nj, nk), with the scale of the header, in the order of the file."""
    try:
        slope, intercept = header.get_slope_inter()
        with np.errstate(all="ignore"):
            values = header.raw_data_from_fileobj(io.BytesIO(data))
            scaled = values if slope in (None, 1.0) and not intercept else values * slope + (intercept or 0.0)
    except Exception as error:
        raise ScenarioError(f"has voxels that cannot be read: {error}", source) from None
    return np.asarray(scaled)
