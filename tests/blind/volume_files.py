"""Cases and volumes as files, by nibabel and pynrrd."""

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

import nibabel
import nrrd
import numpy as np

from tests.blind.obstacle_volumes import ENTRY, TARGET, Case
from tests.blind.voxel_tracer import Ball, Volume

GAUGES_MM = {18: 1.27, 20: 0.9081, 22: 0.7176}  # nominal outer diameters, Birmingham wire gauge


class Format(StrEnum):
    """File and coordinates of a volume."""

    NIFTI = "nii.gz"
    NRRD_LPS = "left-posterior-superior"
    NRRD_RAS = "right-anterior-superior"


def read_volume(file: Path, obstacles: Sequence[int]) -> Volume:
    """Reads labels and affine of a .nii, .nii.gz or .nrrd file."""
    if file.suffix != ".nrrd":
        image = nibabel.load(file)
        return Volume(np.asarray(image.dataobj), np.asarray(image.affine, float), tuple(obstacles))
    labels, header = nrrd.read(str(file))
    affine = np.eye(4)
    affine[:3, :3] = np.asarray(header["space directions"], float).T
    affine[:3, 3] = header["space origin"]
    if header["space"] in ("left-posterior-superior", "LPS"):
        affine[:2] *= -1.0
    elif header["space"] not in ("right-anterior-superior", "RAS"):
        raise ValueError(f"space {header['space']!r}")
    return Volume(labels, affine, tuple(obstacles))


@dataclass(frozen=True)
class FiledAnatomy:
    """What an anatomy file says that a path may meet, the needle's diameter, and the margin that its surface keeps."""

    volume: Volume
    target: Ball | int
    diameter_mm: float
    margin_mm: float = 0.0

    @property
    def cleared_mm(self) -> float:
        """Diameter of the tube about a path that obstacles must not enter."""
        return self.diameter_mm + 2.0 * self.margin_mm


def read_anatomy(file: Path) -> FiledAnatomy:
    """Reads an anatomy file with one margin; labels by number or colour table."""
    document = tomllib.loads(file.read_text())
    anatomy, needle = document["anatomy"], document["needle"]
    if "margins_mm" in anatomy:
        raise ValueError("margins of single labels")
    numbers: dict[str, int] = {}
    if "labels" in anatomy:
        rows = (file.parent / anatomy["labels"]).read_text().splitlines()
        numbers = {row.split()[1]: int(row.split()[0]) for row in rows if row.strip() and not row.startswith("#")}

    def number(label: str | int) -> int:
        return label if isinstance(label, int) else numbers[label.replace(" ", "_")]

    target = anatomy["target"]
    region = Ball(tuple(target["center_mm"]), target["radius_mm"]) if isinstance(target, dict) else number(target)
    diameter = GAUGES_MM[needle["gauge"]] if "gauge" in needle else needle.get("diameter_mm", 0.0)
    obstacles = [number(label) for label in anatomy.get("obstacles", [])]
    volume = read_volume(file.parent / anatomy["file"], obstacles)
    return FiledAnatomy(volume, region, diameter, anatomy.get("margin_mm", 0.0))


def write_volume(volume: Volume, folder: Path, form: str = Format.NIFTI) -> str:
    """Writes labels and affine into a folder, as one of Format; returns the name of the file."""
    labels, affine = volume.labels, volume.affine
    name = "case.nii.gz" if form == Format.NIFTI else "case.nrrd"
    if form == Format.NIFTI:
        image = nibabel.Nifti1Image(labels, affine)
        image.set_sform(affine, 1)
        image.set_qform(affine, 1)
        nibabel.save(image, folder / name)
    else:
        world = np.diag([-1.0, -1.0, 1.0, 1.0]) @ affine if form == Format.NRRD_LPS else affine
        header = {"space": str(form), "space directions": world[:3, :3].T, "space origin": world[:3, 3]}
        nrrd.write(str(folder / name), labels, header | {"kinds": ["domain"] * 3, "encoding": "gzip"})
    return name


def write_case(
    case: Case,
    folder: Path,
    form: str = Format.NIFTI,
    diameter_mm: float | None = 0.0,
    margin_mm: float | None = 0.0,
    more: str = "",
) -> Path:
    """Writes the volume and anatomy.toml into a folder.

    Parameters
    ----------
    case : Case
        The case.
    folder : pathlib.Path
        An existing folder.
    form : str
        One of Format.
    diameter_mm, margin_mm : float or None
        Diameter of the needle, and distance that it keeps from obstacles; None: the key is left out.
    more : str
        Text at the end of the file, such as a table [lattice].

    Returns
    -------
    pathlib.Path
        The anatomy file.
    """
    name = write_volume(case.volume, folder, form)
    regions = {"entry": (case.entry, ENTRY), "target": (case.target, TARGET)}
    lines = [
        'schema = "needleplan.anatomy/1"',
        f'title = "{case.kind} {case.seed}"',
        "",
        "[anatomy]",
        f'file = "{name}"',
    ]
    for key, (ball, label) in regions.items():
        region = f"{{ center_mm = {list(ball.center_mm)}, radius_mm = {ball.radius_mm} }}"
        lines.append(f"{key} = {label if case.by_label else region}")
    lines.append(f"obstacles = {list(case.volume.obstacles)}")
    lines += [] if margin_mm is None else [f"margin_mm = {margin_mm}"]
    lines += [
        "",
        "[needle]",
        f"curvature_radius_mm = {case.curvature_radius_mm}",
        f"tip_noise_deg = {case.tip_noise_deg}",
    ]
    lines += [] if diameter_mm is None else [f"diameter_mm = {diameter_mm}"]
    file = folder / "anatomy.toml"
    file.write_text("\n".join([*lines, "", more]))
    return file
