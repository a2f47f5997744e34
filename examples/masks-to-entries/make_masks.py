"""Write a folder of masks, as segmentation programs do, from an invented anatomy. Take your own folder instead."""

from pathlib import Path

from needleplan.anatomy import Anatomy, LabelVolume, nifti_bytes

NAMES = {
    "prostate": "prostate",
    "rectum": "rectum",
    "bone": "hip_left",
    "vessel": "iliac_artery_left",
    "target": "tumor",
}

phantom = Anatomy.read("phantom/anatomy.toml")
labels = phantom.volume.labels
masks = {name: labels == phantom.names[label] for label, name in NAMES.items()}
masks["body"] = labels > 0
Path("segmentations").mkdir()
for name, inside in masks.items():
    mask = LabelVolume(inside.astype("uint16"), phantom.volume.affine)
    Path(f"segmentations/{name}.nii.gz").write_bytes(nifti_bytes(mask))
