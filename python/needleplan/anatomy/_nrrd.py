"""NRRD files (.nrrd, .nhdr, .seg.nrrd of 3D Slicer); pynrrd reads the header, this module the voxels, within limits.

The header must state the space: RAS, LPS or LAS. All become RAS. Names of segments come from a .seg.nrrd file.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import IO, Any

import numpy as np

from needleplan.anatomy._volume import LabelVolume, counted_bytes, exact_bytes, is_label, require_size, whole_labels
from needleplan.errors import Mistake, ScenarioError, reading

__all__ = ["is_layered", "read_displacements", "read_layers", "read_nrrd"]

# Signs that turn each space into RAS.
_SPACES = {
    "right-anterior-superior": (1, 1, 1), "ras": (1, 1, 1),
    "left-posterior-superior": (-1, -1, 1), "lps": (-1, -1, 1),
    "left-anterior-superior": (-1, 1, 1), "las": (-1, 1, 1),
}  # fmt: skip
_TYPES = {
    "signed char": "i1", "int8": "i1", "int8_t": "i1", "uchar": "u1", "unsigned char": "u1", "uint8": "u1",
    "uint8_t": "u1", "short": "i2", "short int": "i2", "signed short": "i2", "int16": "i2", "int16_t": "i2",
    "ushort": "u2", "unsigned short": "u2", "unsigned short int": "u2", "uint16": "u2", "uint16_t": "u2",
    "int": "i4", "signed int": "i4", "int32": "i4", "int32_t": "i4", "uint": "u4", "unsigned int": "u4",
    "uint32": "u4", "uint32_t": "u4", "longlong": "i8", "int64": "i8", "int64_t": "i8", "uint64": "u8",
    "uint64_t": "u8", "float": "f4", "double": "f8",
}  # fmt: skip
_ENCODINGS = {"raw": False, "gzip": True, "gz": True}
# Number of axes of a segmentation with layers, and of components of a vector.
_LAYERED, _COMPONENTS = 4, 3
# Largest header (bytes).
_LONGEST_HEADER = 2**20


def read_nrrd(path: Path) -> LabelVolume:
    """Return the labels in an NRRD file. Raises ScenarioError if it is damaged or contains no labels with a place."""
    source = str(path)
    with path.open("rb") as stream:
        header = _header(stream, source)
        detached = header.get("data file")
        encoding, kind, affine = _encoding(header, source), _type(header, source), _affine(header, source)
        if detached is None:
            stored = path.stat().st_size - stream.tell()
            values = _values(stream, stored, header, kind, encoding, source)
    if detached is not None:
        data = path.parent / _plain_name(detached, source)
        if not data.is_file():
            raise ScenarioError(Mistake("data file", str(detached), "no such file beside the header"), source)
        with data.open("rb") as stream:
            values = _values(stream, data.stat().st_size, header, kind, encoding, str(data))
    return LabelVolume(whole_labels(values, source), affine, _names(header, source), source)


def is_layered(path: Path) -> bool:
    """Return whether a file is a segmentation with layers: an NRRD file with a list as its first axis.

    Raises ScenarioError if its header is damaged.
    """
    if not path.name.lower().endswith((".nrrd", ".nhdr")):
        return False
    with reading(path, ScenarioError), path.open("rb") as stream:
        header = _header(stream, str(path))
    return len(header.get("sizes", ())) == _LAYERED


def read_layers(path: Path) -> tuple[list[np.ndarray], np.ndarray, dict[str, tuple[int, int]]]:
    """Return the layers of a segmentation, the matrix from voxels to RAS mm, and layer and label of each segment.

    Raises ScenarioError if the file is damaged, or its segments name a layer that it has not.
    """
    source = str(path)
    values, affine, header = _listed(path, ("list",), "layers")
    layers = [whole_labels(layer, source) for layer in values]
    segments = {}
    for name, label in _names(header, source).items():
        keys = (key for key, text in header.items() if re.fullmatch(r"Segment\d+_Name", key) and text == name)
        number = next(keys).removeprefix("Segment").removesuffix("_Name")
        layer = str(header.get(f"Segment{number}_Layer", "0"))
        if not is_label(layer) or int(layer) >= len(layers):
            rule = f"must be a layer of the file, from 0 to {len(layers) - 1}"
            raise ScenarioError(Mistake(f"Segment{number}_Layer", layer, rule), source)
        segments[name] = (int(layer), label)
    return layers, affine, segments


def read_displacements(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return a displacement field in RAS mm, shape (3, ni, nj, nk), and the matrix from its voxels to RAS mm.

    The file is one of ITK or 3D Slicer: vectors as the first axis, in the space that the header states. Raises
    ScenarioError.
    """
    values, affine, header = _listed(path, ("vector", "covariant-vector", "list"), "vectors")
    if len(values) != _COMPONENTS:
        raise ScenarioError(
            Mistake("sizes", f"{len(values)}", "must begin with 3, for vectors of 3 numbers"), str(path)
        )
    signs = np.array(_SPACES[str(header["space"]).lower()], np.float32)
    return np.asarray(values, np.float32) * signs[:, None, None, None], affine


def _listed(path: Path, kinds: tuple[str, ...], noun: str) -> tuple[np.ndarray, np.ndarray, dict[str, Any]]:
    """Return the values of a file with a list or vectors as its first axis, the matrix to RAS mm, and the header."""
    source = str(path)
    try:
        with path.open("rb") as stream:
            header = _header(stream, source)
            sizes = [int(size) for size in header["sizes"]]
            if str(header.get("kinds", [""])[0]) not in kinds or header.get("data file") is not None:
                rule = f"must be a volume, or {noun} in one file with a {kinds[0]} as the first axis"
                raise ScenarioError(Mistake("kinds", str(header.get("kinds")), rule), source)
            header["sizes"] = sizes[1:]
            if (directions := header.get("space directions")) is not None:
                header["space directions"] = np.array(directions, np.float64)[1:]
            encoding, kind, affine = _encoding(header, source), _type(header, source), _affine(header, source)
            count = counted_bytes(sizes[1:], kind.itemsize * sizes[0], "sizes", source)
            stored = path.stat().st_size - stream.tell()
            require_size(count, stored, encoding, "sizes", source)
            data = exact_bytes(stream, count, source, compressed=encoding)
    except (OSError, KeyError, TypeError, ValueError, MemoryError) as error:
        raise ScenarioError(f"cannot be read: {error}", source) from None
    return np.frombuffer(data, kind).reshape(sizes, order="F"), affine, header


def _header(stream: IO[bytes], source: str) -> dict[str, Any]:
    """Return the header, and leave the stream at the first byte after the header."""
    import nrrd

    start = stream.read(_LONGEST_HEADER)
    end = re.search(rb"\r?\n\r?\n", start)
    length = end.end() if end else len(start)
    if not start.startswith(b"NRRD000"):
        raise ScenarioError('is not an NRRD file: it does not begin with "NRRD000"', source)
    stream.seek(length)
    try:
        lines = start[:length].decode("utf-8").splitlines()
        return dict(nrrd.read_header(lines))
    except Exception as error:  # a damaged header fails in its own way
        raise ScenarioError(f"has a damaged NRRD header: {error}", source) from None


def _encoding(header: dict[str, Any], source: str) -> bool:
    encoding = str(header.get("encoding"))
    if encoding not in _ENCODINGS:
        raise ScenarioError(Mistake("encoding", encoding, "must be raw or gzip"), source)
    for key in ("line skip", "byte skip"):
        if header.get(key, 0):
            raise ScenarioError(Mistake(key, str(header[key]), "must be 0 or missing"), source)
    return _ENCODINGS[encoding]


def _type(header: dict[str, Any], source: str) -> np.dtype[Any]:
    name, endian = str(header.get("type")), header.get("endian")
    if name not in _TYPES:
        raise ScenarioError(Mistake("type", name, "must be a type of whole or real numbers"), source)
    kind = np.dtype(_TYPES[name])
    if kind.itemsize > 1 and endian not in ("little", "big"):
        raise ScenarioError(Mistake("endian", str(endian), "must be little or big"), source)
    return kind.newbyteorder(">" if endian == "big" else "<")


def _affine(header: dict[str, Any], source: str) -> np.ndarray:
    """Return the matrix from voxels to RAS mm. Raises ScenarioError if the header does not state it."""
    counted_bytes(header.get("sizes", ()), 1, "sizes", source)
    for key in ("space", "space directions", "space origin"):
        if header.get(key) is None:
            rule = "is missing: the file does not say how its axes lie in the body; export it with an orientation"
            raise ScenarioError(Mistake(key, "", rule), source)
    space = str(header["space"])
    if space.lower() not in _SPACES:
        rule = "must be right-anterior-superior, left-posterior-superior or left-anterior-superior"
        raise ScenarioError(Mistake("space", space, rule), source)
    units = header.get("space units")
    if units is not None and any(unit not in ("mm", "") for unit in units):
        raise ScenarioError(Mistake("space units", " ".join(map(str, units)), "must be mm"), source)
    try:
        directions = np.array(header["space directions"], np.float64)
        origin = np.array(header["space origin"], np.float64)
    except (TypeError, ValueError):
        raise ScenarioError(Mistake("space directions", "", "must be three vectors of three numbers"), source) from None
    if directions.shape != (3, 3) or origin.shape != (3,):
        raise ScenarioError(Mistake("space directions", "", "must be three vectors of three numbers"), source)
    affine = np.eye(4)
    affine[:3, :3], affine[:3, 3] = directions.T, origin
    affine[:3] *= np.array(_SPACES[space.lower()])[:, None]
    return affine


def _plain_name(name: object, source: str) -> str:
    """Return the name of the file of the voxels, which must lie beside the header."""
    if not isinstance(name, str) or Path(name).name != name or name.startswith("LIST"):
        raise ScenarioError(Mistake("data file", str(name), "must be the name of one file beside the header"), source)
    return name


def _values(
    stream: IO[bytes], stored: int, header: dict[str, Any], kind: np.dtype[Any], compressed: bool, source: str
) -> np.ndarray:
    count = counted_bytes(header["sizes"], kind.itemsize, "sizes", source)
    require_size(count, stored, compressed, "sizes", source)
    data = exact_bytes(stream, count, source, compressed=compressed)
    sizes = [int(size) for size in header["sizes"]]
    return np.frombuffer(data, kind).reshape(sizes, order="F")


def _names(header: dict[str, Any], source: str) -> dict[str, int]:
    """Return the labels of the segments of a .seg.nrrd file, by name."""
    found: dict[str, int] = {}
    for key, name in header.items():
        if match := re.fullmatch(r"Segment(\d+)_Name", key):
            number = header.get(f"Segment{match[1]}_LabelValue", "")
            if not is_label(str(number)):
                raise ScenarioError(Mistake(f"Segment{match[1]}_LabelValue", str(number), "must be a number"), source)
            if str(name) in found:
                raise ScenarioError(Mistake(key, str(name), "is the name of another segment too"), source)
            found[str(name)] = int(number)
    return found
