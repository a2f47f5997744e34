"""Small volumes and anatomies for tests."""

from pathlib import Path
from typing import Any

import numpy as np

from needleplan.anatomy import Anatomy, AnatomyFile, LabelVolume, nifti_bytes

NAMES = {"air": 0, "body": 1, "entry": 2, "target": 3, "vessel": 4}

TEXT = """\
schema = "needleplan.anatomy/1"
title = "A box (invented)"
[anatomy]
file = "box.nii.gz"
labels = "labels.ctbl"
target = "target"
entry = "entry"
obstacles = ["vessel"]
outside = ["air"]
[needle]
curvature_radius_mm = 60.0
diameter_mm = 0.0
[lattice]
spacing_mm = 4.0
step_mm = 8.0
cone_deg = 24.0
directions_deg = 8.0
rolls = 4
"""


def box(wall: bool = False) -> np.ndarray:
    """Return labels, voxels of 2 mm: a body with an entry region at its lower end and a target at its upper end."""
    labels = np.zeros((20, 20, 30), np.uint16)
    labels[1:19, 1:19, 2:29] = NAMES["body"]
    labels[6:14, 6:14, 2:4] = NAMES["entry"]
    labels[7:13, 7:13, 24:28] = NAMES["target"]
    labels[10:13, 4:8, 12:16] = NAMES["vessel"]
    if wall:
        labels[:, :, 18:21] = NAMES["vessel"]
    return labels


def anatomy(labels: np.ndarray, text: str = TEXT) -> Anatomy:
    """Return an anatomy with these labels, without files."""
    volume = LabelVolume(labels, np.diag([2.0, 2.0, 2.0, 1.0]))
    return Anatomy(AnatomyFile.from_toml(text), volume, NAMES)


def write(folder: Path, labels: np.ndarray, text: str = TEXT) -> Path:
    """Write an anatomy into a folder and return the anatomy file."""
    (folder / "box.nii.gz").write_bytes(nifti_bytes(LabelVolume(labels, np.diag([2.0, 2.0, 2.0, 1.0]))))
    (folder / "labels.ctbl").write_text("".join(f"{number} {name} 0 0 0 255\n" for name, number in NAMES.items()))
    (folder / "anatomy.toml").write_text(text)
    return folder / "anatomy.toml"


def rotation(seed: int) -> Any:
    """Return a random rotation matrix."""
    matrix, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    return matrix * np.sign(np.linalg.det(matrix))
