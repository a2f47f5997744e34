"""Invented labelled anatomies: liver, lung, prostate and brain.

Shapes and sizes are made up from balls, ellipsoids and tubes; they resemble organs only in their topology. The seed
moves vessels and target. Nothing here comes from a patient, and no conclusion about patients can be drawn from it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from needleplan.anatomy._labels import require_libraries
from needleplan.anatomy._nifti import nifti_bytes
from needleplan.anatomy._volume import LabelVolume
from needleplan.artifacts import write_whole
from needleplan.errors import Mistake, ScenarioError

if TYPE_CHECKING:
    import os

    from numpy.typing import NDArray

__all__ = ["PHANTOMS", "phantom_files", "write_phantom"]

# Voxel size (mm) of all phantoms.
_VOXEL_MM = 2.0
# Label, name and colour of the labels that all phantoms share; organs follow from 10 on.
_AIR, _BODY, _ENTRY, _TARGET, _VESSEL, _BONE = 0, 1, 2, 3, 4, 5
_NAMES = {
    _AIR: ("air", "0 0 0 0"), _BODY: ("body", "177 122 101 255"), _ENTRY: ("entry", "0 158 115 255"),
    _TARGET: ("target", "230 159 0 255"), _VESSEL: ("vessel", "0 114 178 255"), _BONE: ("bone", "241 214 145 255"),
}  # fmt: skip


class _Canvas:
    """Labels on a grid, painted shape by shape. `half_mm`: half the size of the volume; RAS mm from its centre."""

    def __init__(self, half_mm: tuple[float, float, float], seed: int) -> None:
        counts = [2 * round(half / _VOXEL_MM) + 1 for half in half_mm]
        self.affine = np.diag([_VOXEL_MM] * 3 + [1.0])
        self.affine[:3, 3] = [-(count // 2) * _VOXEL_MM for count in counts]
        axes = [(np.arange(count) - count // 2) * _VOXEL_MM for count in counts]
        self.points = np.stack(np.meshgrid(*axes, indexing="ij"), -1)
        self.labels = np.zeros(counts, np.uint16)
        self.random = np.random.default_rng(seed)

    def ellipsoid(self, center: tuple[float, ...], radii: tuple[float, ...]) -> NDArray[np.bool_]:
        """Return the voxels in an ellipsoid."""
        return np.asarray((((self.points - np.array(center)) / np.array(radii)) ** 2).sum(-1) <= 1)

    def tube(self, corners: list[tuple[float, ...]], radius: float) -> NDArray[np.bool_]:
        """Return the voxels in a tube about the line through `corners`."""
        inside = np.zeros(self.labels.shape, bool)
        for start, end in zip(np.array(corners[:-1]), np.array(corners[1:]), strict=True):
            along = end - start
            share = np.clip((self.points - start) @ along / (along @ along), 0, 1)[..., None]
            inside |= np.linalg.norm(self.points - start - share * along, axis=-1) <= radius
        return inside

    def paint(self, label: int, where: NDArray[np.bool_], on: NDArray[np.bool_] | None = None) -> None:
        """Set the label of voxels, if given only of those in `on`."""
        self.labels[where if on is None else where & on] = label

    def near(self, center: tuple[float, ...], by_mm: float) -> tuple[float, ...]:
        """Return a place near another one: each coordinate differs by up to `by_mm`."""
        return tuple(np.array(center) + by_mm * (2 * self.random.random(3) - 1))

    def patch(self, center: tuple[float, ...], radius: float) -> None:
        """Make the surface of the body near a place the entry region."""
        from scipy import ndimage

        body = self.labels != _AIR
        surface = body & ~np.asarray(ndimage.binary_erosion(body, iterations=2))
        self.paint(_ENTRY, surface & self.ellipsoid(center, (radius,) * 3) & (self.labels == _BODY))


def _liver(canvas: _Canvas) -> dict[int, str]:
    body = canvas.ellipsoid((0, 0, 0), (80, 60, 200))
    canvas.paint(_BODY, body)
    liver = canvas.ellipsoid((20, 0, 0), (48, 45, 44)) & canvas.ellipsoid((0, 0, 0), (72, 52, 190))
    canvas.paint(10, liver)
    canvas.paint(11, canvas.ellipsoid((-4, 22, -24), (8, 10, 14)))
    for height in (-30, -6, 18, 42):
        canvas.paint(_BONE, canvas.tube([(30, 46, height), (56, 32, height + 6), (70, 10, height + 12)], 3.5), body)
    hilum = canvas.near((-14, -8, -4), 3)
    for end in ((42, 14, 26), (46, -22, 4), (30, 10, -28), (6, -18, 30)):
        canvas.paint(_VESSEL, canvas.tube([hilum, canvas.near((14, -4, 2), 6), canvas.near(end, 6)], 3.2), liver)
    canvas.paint(_TARGET, canvas.ellipsoid(canvas.near((12, -28, 8), 4), (6, 6, 6)))
    canvas.patch((60, 38, 6), 28)
    return {10: "liver 221 130 101 255", 11: "gallbladder 139 150 98 255"}


def _lung(canvas: _Canvas) -> dict[int, str]:
    body = canvas.ellipsoid((0, 0, 0), (76, 58, 220))
    canvas.paint(_BODY, body)
    lung = canvas.ellipsoid((30, 0, 0), (38, 44, 54))
    canvas.paint(10, lung)
    for height in (-38, -14, 10, 34):
        canvas.paint(_BONE, canvas.tube([(24, 50, height), (50, 38, height + 5), (70, 10, height + 10)], 3.5), body)
    hilum = canvas.near((2, -4, 0), 2)
    for end in ((50, 10, 30), (54, -8, 2), (44, 14, -26), (30, -26, 20), (34, 24, 8)):
        canvas.paint(_VESSEL, canvas.tube([hilum, canvas.near((22, -2, 2), 5), canvas.near(end, 5)], 2.4), lung)
        canvas.paint(11, canvas.tube([(0, -2, 40), hilum, canvas.near((20, -10, -8), 4)], 3.0))
    canvas.paint(_TARGET, canvas.ellipsoid(canvas.near((24, -24, -8), 4), (6, 6, 6)))
    canvas.patch((56, 40, 2), 28)
    return {10: "lung 128 174 128 255", 11: "bronchus 90 170 200 255"}


def _prostate(canvas: _Canvas) -> dict[int, str]:
    body = canvas.ellipsoid((0, 0, 30), (62, 52, 84))
    canvas.paint(_BODY, body)
    canvas.paint(10, canvas.ellipsoid((0, 0, 10), (25, 20, 22)))
    canvas.paint(11, canvas.tube([(0, 4, -54), canvas.near((0, 6, -14), 1.5), (0, 2, 30)], 3.0), body)
    canvas.paint(12, canvas.tube([(0, -36, -50), (0, -30, -10), canvas.near((0, -34, 40), 2)], 9.0), body)
    canvas.paint(13, canvas.ellipsoid((0, 8, 50), (28, 24, 20)))
    for side in (-1, 1):
        canvas.paint(_BONE, canvas.tube([(side * 6, 34, -6), (side * 30, 14, -34)], 6.0), body)
        canvas.paint(_VESSEL, canvas.tube([canvas.near((side * 29, -14, -8), 2), (side * 28, -16, 30)], 3.0), body)
    canvas.paint(_TARGET, canvas.ellipsoid(canvas.near((12, -8, 18), 3), (5, 5, 5)))
    canvas.patch((0, -8, -54), 26)
    return {10: "prostate 230 158 140 255", 11: "urethra 240 228 66 255", 12: "rectum 160 110 70 255",
            13: "bladder 222 154 132 255"}  # fmt: skip


def _brain(canvas: _Canvas) -> dict[int, str]:
    canvas.paint(_BODY, canvas.ellipsoid((0, 0, 0), (76, 90, 74)))
    canvas.paint(_BONE, canvas.ellipsoid((0, 0, 0), (72, 86, 70)))
    brain = canvas.ellipsoid((0, 0, 0), (66, 80, 64))
    canvas.paint(10, brain)
    for side in (-1, 1):
        canvas.paint(11, canvas.ellipsoid(canvas.near((side * 11, 4, 8), 1.5), (6, 24, 9)))
    canvas.paint(_VESSEL, canvas.tube([(0, 70, 20), (0, 30, 56), (0, -50, 44)], 4.0), brain)
    for middle, end in (((24, 30, 34), (50, 6, 20)), ((20, 44, 0), (48, 30, -12)), ((14, -10, 40), (40, -30, 30))):
        canvas.paint(_VESSEL, canvas.tube([(4, 36, 50), canvas.near(middle, 5), canvas.near(end, 5)], 2.2), brain)
    canvas.paint(_TARGET, canvas.ellipsoid(canvas.near((24, -8, -4), 4), (6, 6, 6)))
    hole = canvas.tube([(30, 30, 40), (48, 54, 74)], 16.0) & (canvas.labels != _AIR) & ~brain
    canvas.paint(_BODY, hole)
    canvas.patch((40, 44, 56), 26)
    return {10: "brain 250 250 225 255", 11: "ventricle 88 106 215 255"}


@dataclass(frozen=True)
class _Kind:
    """A phantom: how to paint it, half its size (mm), radius of the arc, further obstacles, and organ."""

    paint: Callable[[_Canvas], dict[int, str]]
    half_mm: tuple[float, float, float]
    radius_mm: float
    obstacles: tuple[str, ...]
    organ: str


PHANTOMS = {
    "liver": _Kind(_liver, (86, 66, 60), 80.0, ("gallbladder",), "liver"),
    "lung": _Kind(_lung, (82, 64, 62), 80.0, ("bronchus",), "lung"),
    "prostate": _Kind(_prostate, (66, 58, 66), 70.0, ("urethra", "rectum", "bladder"), "prostate"),
    "brain": _Kind(_brain, (80, 94, 78), 70.0, ("ventricle",), "brain"),
}
"""The phantoms by name."""

_TOML = Path(__file__).with_name("phantom.txt")


def phantom_files(name: str) -> tuple[str, str, str]:
    """Return the names of the files of a phantom: volume, colour table, anatomy file."""
    return f"{name}.nii.gz", "labels.ctbl", "anatomy.toml"


def write_phantom(name: str, folder: str | os.PathLike[str], seed: int = 0) -> Path:
    """Write an invented anatomy: volume, colour table and anatomy file.

    Parameters
    ----------
    name : str
        `liver`, `lung`, `prostate` or `brain`.
    folder : str or path
        The folder; it is made if it does not exist.
    seed : int, default 0
        The same seed gives the same files.

    Returns
    -------
    pathlib.Path
        The anatomy file.

    Raises
    ------
    ScenarioError
        If the libraries for volumes are not installed, or the seed is negative.
    OutputError
        If a file cannot be written.
    """
    require_libraries(name)
    if seed < 0:
        raise ScenarioError(Mistake("seed", f"{seed}", "must be a whole number from 0"))
    kind = PHANTOMS[name]
    canvas = _Canvas(kind.half_mm, seed)
    organs = kind.paint(canvas)
    lines = [f"{number} {label} {color}" for number, (label, color) in _NAMES.items()]
    lines += [f"{number} {line}" for number, line in organs.items()]
    table = "# Invented anatomy: names and colours of its labels\n" + "\n".join(lines) + "\n"
    text = _TOML.read_text(encoding="utf-8").format(
        name=name, seed=seed, organ=kind.organ, radius=kind.radius_mm, softer=1.25 * kind.radius_mm,
        obstacles=", ".join(f'"{each}"' for each in ("vessel", "bone", *kind.obstacles)),
    )  # fmt: skip
    volume, colors, file = (Path(folder) / phantom_file for phantom_file in phantom_files(name))
    Path(folder).mkdir(parents=True, exist_ok=True)
    write_whole(volume, nifti_bytes(LabelVolume(canvas.labels, canvas.affine)))
    write_whole(colors, table.encode())
    write_whole(file, text.encode())
    return file
