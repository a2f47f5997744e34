"""Invented cases of many masks, of layers and of two labels; SimpleITK writes the masks."""

import json
from pathlib import Path

import nibabel
import nrrd
import numpy as np
import SimpleITK as sitk  # noqa: N813

from needleplan.anatomy import AnatomyCase, CaseChoices, read_case

LPS = np.array([-1.0, -1.0, 1.0])
# Balls of the invented case: centre in RAS mm and radius.
BALLS = {
    "body": ((0.0, 0.0, 0.0), 40.0), "liver": ((10.0, 0.0, 0.0), 18.0), "tumor": ((12.0, 4.0, 2.0), 5.0),
    "portal_vein": ((0.0, -6.0, 0.0), 4.0), "rib_left_7": ((-20.0, 10.0, 0.0), 4.0),
    "spleen": ((-18.0, -14.0, 0.0), 8.0),
}  # fmt: skip


def mask(name: str, spacing: float = 2.0, turn_deg: float = 0.0, shift: float = 0.0) -> sitk.Image:
    """Return the mask of a ball on a grid of its own, which is turned about z."""
    angle, count = np.radians(turn_deg), round(100 / spacing)
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    image = sitk.Image([count] * 3, sitk.sitkUInt8)
    image.SetSpacing([spacing] * 3)
    image.SetDirection(turn.ravel().tolist())
    image.SetOrigin((turn @ np.full(3, -spacing * (count - 1) / 2) + shift).tolist())
    places = np.stack(np.meshgrid(*[np.arange(count)] * 3, indexing="ij"), -1) * spacing
    center, radius = BALLS[name]
    lps = places @ turn.T + np.array(image.GetOrigin())
    inside = np.linalg.norm(lps - LPS * center, axis=-1) <= radius
    found = sitk.GetImageFromArray(inside.transpose(2, 1, 0).astype(np.uint8))
    found.CopyInformation(image)
    return found


def write_masks(folder: Path, names: tuple[str, ...] = tuple(BALLS), **grids: dict[str, float]) -> Path:
    folder.mkdir(exist_ok=True)
    for name in names:
        sitk.WriteImage(mask(name, **grids.get(name, {})), str(folder / f"{name}.nii.gz"))
    return folder


def segments(layers: dict[str, tuple[int, int]]) -> dict[str, str]:
    header = {}
    for number, (name, (layer, label)) in enumerate(layers.items()):
        header |= {f"Segment{number}_Name": name, f"Segment{number}_Layer": str(layer),
                   f"Segment{number}_LabelValue": str(label)}  # fmt: skip
    return header


def layered(folder: Path, **changes: str) -> Path:
    """Write a segmentation of 3D Slicer with two layers, in LPS."""
    images = {name: sitk.GetArrayFromImage(mask(name)).transpose(2, 1, 0) for name in BALLS}
    data = np.zeros((2, 50, 50, 50), np.uint8)
    data[0][images["body"] > 0] = 1
    data[0][images["liver"] > 0] = 2
    data[1][images["portal_vein"] > 0] = 1
    data[1][images["tumor"] > 0] = 2
    directions = np.vstack([np.full(3, np.nan), 2.0 * np.eye(3)])
    names = {"body": (0, 1), "liver": (0, 2), "portal_vein": (1, 1), "tumor": (1, 2)}
    header = {
        "space": "left-posterior-superior", "space directions": directions, "space origin": [-49.0] * 3,
        "kinds": ["list", "domain", "domain", "domain"], "encoding": "gzip", **segments(names), **changes,
    }  # fmt: skip
    folder.mkdir(exist_ok=True)
    nrrd.write(str(folder / "all.seg.nrrd"), data, header)
    return folder


TABLES = {
    "all.ctbl": "1 body 1 2 3 255\n2 tumor 4 5 6 255\n",
    "all.csv": "LabelValue,Name,Color_R\n1,body,3\n2,tumor,4\n",
    "all.txt": '# ITK-SNAP\n0 0 0 0 0 0 0 "Clear Label"\n1 255 0 0 1 1 1 "body"\n2 0 255 0 1 1 1 "tumor"\n',
}


def two_labels(folder: Path) -> nibabel.Nifti1Image:
    """Write a body of 40 mm with a tumor of 6 mm as the labels 1 and 2 of all.nii.gz."""
    folder.mkdir()
    labels = np.zeros((30, 30, 30), np.uint8)
    labels[5:25, 5:25, 5:25] = 1
    labels[14:17, 14:17, 14:17] = 2
    image = nibabel.Nifti1Image(labels, np.diag([2.0, 2.0, 2.0, 1.0]))
    nibabel.save(image, folder / "all.nii.gz")
    return image


def case_of_labels(folder: Path, choices: CaseChoices | None = None) -> AnatomyCase:
    two_labels(folder)
    (folder / "all.ctbl").write_text(TABLES["all.ctbl"])
    return read_case(folder, choices)


def markups(system: str, **points: list[float]) -> str:
    listed = [{"label": label, "position": position, "positionStatus": "defined"} for label, position in points.items()]
    return json.dumps({"markups": [{"type": "Fiducial", "coordinateSystem": system, "controlPoints": listed}]})
