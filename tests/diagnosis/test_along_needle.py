"""Curvature along the needle beside a model of the tip: sensors of a needle that is as modelled, and that is not."""

import numpy as np
import pytest

from needleplan.cli.diagnose import _SENSORS
from needleplan.diagnosis import Library, diagnose
from needleplan.diagnosis._along_needle import curvature_remarks, image_remarks
from needleplan.models import ModelFile, ShaftAndTip, SpatialBicycle
from needleplan.models.deflection import FibreSensors
from needleplan.models.effects import effect_named
from needleplan.models.path import ImagePlane
from needleplan.signals import IMAGE_COLUMNS, Array, Record, Role
from tests.diagnosis.tip_trials import BASE, motion, recordings

SENSORS = FibreSensors.at((5.0, 20.0))


def sensed(record: Record, curvature_per_mm: float, kind: int, seed: int = 3) -> Record:
    """The record with the curvatures of an arc toward the bevel, whose side the rest in the middle has turned."""
    path, random = motion(kind), np.random.default_rng(seed)
    cut = np.maximum.accumulate(path.depth_mm)
    columns: dict[str, Array] = {}
    for name, behind in zip(("fbg1", "fbg2"), SENSORS.from_tip_mm, strict=True):
        place = path.depth_mm - behind
        then = np.interp(place, *(each[np.append(True, np.diff(cut) > 0)] for each in (cut, path.angle_rad)))
        turned = np.where(place > 0, curvature_per_mm, 0.0) * np.exp(1j * (then - path.angle_rad))
        columns[f"{name}_y_per_mm"] = turned.real + random.normal(0, 2e-4, place.size)
        columns[f"{name}_z_per_mm"] = turned.imag + random.normal(0, 2e-4, place.size)
    for name, values in columns.items():
        record = record.with_column(name, values)
    return record


def trials(curvature_per_mm: float) -> list[Record]:
    *moved, noise = recordings()
    return [*(sensed(record, curvature_per_mm, kind) for kind, record in enumerate(moved)), noise]


def imaged(plane: ImagePlane) -> list[Record]:
    """The records with the tip in images: 0.5 mm of noise, every third image missed, some far off."""
    random, found = np.random.default_rng(4), []
    for record in recordings()[:-1]:
        tip = np.stack([record[name] for name in ("x_mm", "y_mm", "z_mm")], 1)
        places = (tip - plane.origin_mm) @ plane.axes[:2].T + random.normal(0, 0.5, (len(record), 2))
        places[::3], places[::20] = np.nan, 30.0
        for name, values in zip(IMAGE_COLUMNS, places.T, strict=True):
            record = record.with_column(name, values)
        found.append(record)
    return found


def test_sensors_of_a_needle_as_modelled_agree_also_after_a_rotation() -> None:
    (remark,) = curvature_remarks(BASE, trials(BASE.curvature_per_mm), SENSORS)
    assert "2 sensors agree with the model" in remark
    assert list(curvature_remarks(BASE, recordings(), SENSORS)) == []


def test_columns_that_are_not_compared_have_one_remark() -> None:
    (unused,) = curvature_remarks(BASE, trials(0.005), None)
    assert unused.endswith("are not used, because the model file has no [fibre]")
    force = ShaftAndTip(friction=0.01, cutting=0.3, onset_mm=2.0, presliding_mm=0.1)
    (unused,) = curvature_remarks(force, trials(0.005), SENSORS)
    assert unused.endswith("because the model has no path of the tip in 3D")
    (unused,) = image_remarks(BASE, imaged(ImagePlane()), None)
    assert unused.endswith("image_u_mm and image_v_mm are not used, because the model file has no [ultrasound]")
    assert unused.startswith(_SENSORS)  # the command prints it without --verbose


def test_images_of_a_tip_that_is_not_where_the_model_says_differ_also_with_outliers() -> None:
    plane = ImagePlane(origin_mm=(10.0, -5.0, 0.0), u_axis=(0.0, 1.0, 0.0), v_axis=(0.0, 0.0, 1.0))
    (agree,) = image_remarks(BASE, imaged(plane), plane)
    assert "agree with the model" in agree
    (apart,) = image_remarks(BASE.with_values(curvature_per_mm=0.0035), imaged(plane), plane)
    assert "differ from the model: +" in apart
    assert list(image_remarks(BASE, recordings(), plane)) == []


def test_a_needle_that_bends_more_than_its_tip_tells_is_named_by_its_sensors() -> None:
    remarks = list(curvature_remarks(SpatialBicycle(0.004), trials(0.005), SENSORS))
    assert [each.split(" mm behind")[0].split()[-1] for each in remarks] == ["5", "20"]
    assert all("differs from the model by +1 1/m toward the bevel" in each for each in remarks)
    assert all(each.startswith(_SENSORS) for each in remarks)  # the command prints them without --verbose


@pytest.mark.slow
def test_a_diagnosis_has_the_remark_if_the_model_file_has_the_sensors() -> None:
    records = trials(0.007)
    assert {each.role for each in records} == {Role.TRAIN, Role.HOLDOUT, Role.NOISE}
    few = Library([effect_named(name) for name in ("curvature_speed", "pre_bend")], BASE)
    found = diagnose(ModelFile(BASE, fibre=SENSORS), records, library=few)
    assert any(
        "5 mm behind the tip it differs from the model by +2 1/m toward the bevel" in each for each in found.remarks
    )
