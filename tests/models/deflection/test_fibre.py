import math
from pathlib import Path

import numpy as np
import pytest

from needleplan.errors import DataError, ModelError
from needleplan.models import LayeredShape, ModelFile
from needleplan.models.deflection import FibreSensors
from needleplan.recording import read_records, write_records
from needleplan.signals import Array, Record

PLACES = (10.0, 35.0, 70.0)
SENSORS = FibreSensors(PLACES, core_angles_rad=(0.3, 0.3 + 2 * math.pi / 3, 0.3 + 4 * math.pi / 3), core_radius_mm=0.1)


def strains(curvature: Array, common: float | Array = 0.0, sensors: FibreSensors = SENSORS) -> Array:
    """Strains of fibres that a bend stretches on its outer side: the length of a circle through the core."""
    angles, radius = np.array(sensors.core_angles_rad), sensors.core_radius_mm
    toward = radius * (
        np.multiply.outer(curvature[..., 0], np.cos(angles)) + np.multiply.outer(curvature[..., 1], np.sin(angles))
    )
    return np.asarray(-toward + np.asarray(common)[..., None])


def curvatures(samples: int = 50) -> Array:
    return 0.003 * np.random.default_rng(2).standard_normal((samples, len(PLACES), 2))


def test_a_temperature_drift_of_all_cores_changes_no_curvature() -> None:
    true = curvatures()
    drift = np.linspace(0, 3e-4, 50)[:, None] * np.ones(len(PLACES))  # 30 K in glass, as large as the bending
    read = SENSORS.curvatures(strains(true, drift))
    np.testing.assert_allclose(read.curvature_per_mm, true, atol=1e-15)
    np.testing.assert_allclose(read.common_strain, drift, atol=1e-16)
    assert read.notes == ()


def test_one_broken_core_of_three_ends_its_sensor_and_of_four_does_not() -> None:
    true = curvatures()
    three = strains(true)
    three[20:, 1, 2] = np.nan
    read = SENSORS.curvatures(three)
    assert np.isnan(read.curvature_per_mm[20:, 1]).all()
    np.testing.assert_allclose(np.delete(read.curvature_per_mm, 1, axis=1), np.delete(true, 1, axis=1), atol=1e-15)
    np.testing.assert_allclose(read.curvature_per_mm[:20], true[:20], atol=1e-15)
    assert read.notes == ("core 3 of the sensor 35 mm from the tip is not readable in 30 of 50 samples: is it broken?",)
    more = FibreSensors(PLACES, core_angles_rad=(0.0, 1.5, 3.0, 4.5))
    four = strains(true, 1e-4, more)
    four[:, :, 0] = 0.5  # a strain that no glass survives
    np.testing.assert_allclose(more.curvatures(four).curvature_per_mm, true, atol=1e-14)


def test_cores_that_determine_nothing_are_refused() -> None:
    broken = strains(curvatures())
    broken[:, :, 0] = np.nan
    with pytest.raises(DataError, match="temperature looks like curvature"):
        SENSORS.curvatures(broken)
    with pytest.raises(DataError, match=r"\(n, 3, 3\)"):
        SENSORS.curvatures(broken[:, :2])


@pytest.mark.parametrize(("values", "rule"), [
    ({"from_tip_mm": (35.0, 10.0)}, "the nearest sensor first"),
    ({"from_tip_mm": (10.0, 10.0)}, "the nearest sensor first"),
    ({"from_tip_mm": ()}, "must be 1 to 8 numbers in mm"),
    ({"from_tip_mm": (1.0, 20.0)}, "must begin at half of gauge_mm"),
    ({"from_tip_mm": (10.0,), "core_angles_rad": (0.0, 3.0)}, "must be 3 to 16 numbers in rad"),
    ({"from_tip_mm": (math.nan,)}, "from_tip_mm"),
])  # fmt: skip
def test_sensors_out_of_order_are_refused(values: dict[str, tuple[float, ...]], rule: str) -> None:
    with pytest.raises(ModelError, match=rule):
        FibreSensors(**values)  # type: ignore[arg-type]


def test_a_needle_shorter_than_its_sensors_is_a_mistake() -> None:
    assert list(SENSORS.require_length(80.0)) == []
    (mistake,) = SENSORS.require_length(72.0)
    assert "must end within the needle, which is 72 mm long" in mistake.rule


def record(scale: float = 1.0) -> Record:
    time = np.arange(50) / 10
    columns = {name: scale * row for name, row in zip(SENSORS.columns, curvatures().reshape(50, -1).T, strict=True)}
    return Record({"time_s": time, "depth_mm": 5 * time, **columns}, "first")


@pytest.mark.parametrize("ending", ["csv", "h5", "mat"])
def test_the_columns_survive_every_kind_of_file(ending: str, tmp_path: Path) -> None:
    write_records([record()], tmp_path / f"data.{ending}")
    (again,) = read_records(tmp_path / f"data.{ending}")
    np.testing.assert_array_equal(SENSORS.measured(again), curvatures())


def test_curvatures_in_1_per_m_are_refused(tmp_path: Path) -> None:
    write_records([record(1000.0)], tmp_path / "data.csv")
    with pytest.raises(DataError, match=r"fbg1_y_per_mm.*questionably large, in 1/m"):
        read_records(tmp_path / "data.csv")
    text = (tmp_path / "data.csv").read_text()
    (tmp_path / "data.csv").write_text(text.replace("fbg2_y_per_mm", "fbg2_y_per_m"))
    with pytest.raises(DataError, match=r"fbg2_y_per_m.*must be fbg2_y_per_mm: multiply by 0.001"):
        read_records(tmp_path / "data.csv", accept_units=True)


def test_a_record_with_other_sensors_than_the_needle_is_refused() -> None:
    with pytest.raises(DataError, match=r"fbg3_y_per_mm.*is not a sensor of the needle, which has 2"):
        FibreSensors(PLACES[:2]).measured(record())
    with pytest.raises(DataError, match=r"fbg4_z_per_mm.*is missing"):
        FibreSensors((*PLACES, 100.0)).measured(record())


def test_a_sensor_that_stands_still_is_noted(tmp_path: Path) -> None:
    time = np.arange(600) / 100
    values = 0.002 * np.sin(time) + 1e-5 * np.random.default_rng(1).standard_normal(600)
    values[300:400] = values[300]
    data = Record({"time_s": time, "depth_mm": 10 * time, "fbg1_y_per_mm": values}, "first")
    write_records([data], tmp_path / "data.csv")
    (again,) = read_records(tmp_path / "data.csv")
    assert any("fbg1_y_per_mm stands still" in note for note in again.notes)


def test_a_model_file_holds_the_sensors_and_names_their_mistakes() -> None:
    file = ModelFile(LayeredShape(0.002, start_n_per_mm=0.002), fibre=SENSORS)
    again = ModelFile.from_toml(file.to_toml())
    assert again == file
    assert again.fibre == SENSORS
    assert "fibre" not in ModelFile(file.model).to_toml()
    with pytest.raises(ModelError, match=r"fibre.from_tip_mm.*the nearest sensor first"):
        ModelFile.from_toml(file.to_toml().replace("10.0, 35.0, 70.0", "70.0, 35.0, 10.0"))
