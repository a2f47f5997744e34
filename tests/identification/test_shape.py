"""`identify shape`: curvatures of sensors to kappa_c and omega_init, against published numbers and a known truth."""

import json
from pathlib import Path

import numpy as np
import pytest

from needleplan.cli.identify_options import sensors_at
from needleplan.errors import DataError, InputError, ModelError
from needleplan.identification.shape import identify
from needleplan.models import LayeredShape, ModelFile
from needleplan.models.deflection import FibreSensors
from needleplan.recording import write_records
from needleplan.signals import Array, Record
from tests.cli.commands import needleplan

PUBLISHED = Path(__file__).parents[3] / "shared" / "data" / "needle_shape" / "shape_stuff.json"
PLACES = (10.0, 35.0, 70.0, 100.0)
SENSORS = FibreSensors.at(PLACES)
TRUTH = LayeredShape(0.003, 0.002, -0.001, second_per_mm=0.006, boundary_mm=60.0)


def record(curvature: Array, depth_mm: float, name: str = "") -> Record:
    """A record that ends at a depth with curvatures of the shape (samples, sensors, 2)."""
    samples = len(curvature)
    columns = {"time_s": np.arange(samples) / 20, "depth_mm": depth_mm + np.linspace(-2, 0, samples)}
    names = FibreSensors(tuple(np.arange(3.0, 3.0 + curvature.shape[1]))).columns
    return Record(columns | dict(zip(names, curvature.reshape(samples, -1).T, strict=True)), name)


def insertion(seed: int) -> Record:
    true = TRUTH.curvatures([120.0], PLACES)
    bias = np.random.default_rng(seed).normal(0, 2e-5, (1, len(PLACES), 2))
    return record(np.repeat(true + bias, 60, axis=0), 120.0, f"trial {seed}")


@pytest.mark.skipif(not PUBLISHED.exists(), reason="the published shape is not on this machine")
def test_the_intervals_hold_the_published_constants() -> None:
    published = json.loads(PUBLISHED.read_text())
    curvature = np.array(published["curvatures"]).T
    found = identify(
        [record(np.repeat(curvature[None], 60, axis=0), published["L"])], fibre=FibreSensors.at(published["s_aa"])
    )
    wanted = {"intrinsic_per_mm": published["kc"]}
    wanted |= dict(zip(("start_n_per_mm", "start_b_per_mm"), published["winit"], strict=False))
    for name, value in wanted.items():
        assert found.estimates[name].low < value < found.estimates[name].high


def test_the_intervals_hold_the_truth_of_two_layers() -> None:
    found = identify([insertion(seed) for seed in range(3)], fibre=SENSORS, boundary_mm=60.0)
    for name, estimate in found.estimates.items():
        assert estimate.low < TRUTH.values()[name] < estimate.high
        assert estimate.high - estimate.low < 4e-3
    one, two = (identify([insertion(0)], fibre=SENSORS, boundary_mm=layers) for layers in (None, 60.0))
    assert one.scores[0][1] > 3 * two.scores[0][1]  # one layer does not fit


def test_wrong_sensors_have_one_clear_error() -> None:
    with pytest.raises(DataError, match="--sensors: is missing"):
        identify([insertion(0)])
    with pytest.raises(InputError, match="in mm, not in m"):
        sensors_at("0.010,0.035")
    with pytest.raises(ModelError, match="the nearest sensor first"):
        identify([insertion(0)], fibre=FibreSensors.at(PLACES[::-1]))
    with pytest.raises(DataError, match="is not a sensor of the needle, which has 2"):
        identify([insertion(0)], fibre=FibreSensors.at(PLACES[:2]))
    with pytest.raises(DataError, match="in 1/m"):
        identify([record(1e3 * TRUTH.curvatures([120.0] * 60, PLACES), 120.0)], fibre=SENSORS)
    short = LayeredShape(0.003, 0.002).curvatures([12.0] * 60, PLACES)
    with pytest.raises(DataError, match="too few sensors are in the tissue"):
        identify([record(short, 12.0)], fibre=SENSORS)


def test_a_sensor_that_no_insertion_brings_into_the_tissue_is_named() -> None:
    inside = insertion(0)
    far = inside.with_column("fbg5_y_per_mm", 0 * inside["time_s"]).with_column("fbg5_z_per_mm", 0 * inside["time_s"])
    found = identify([far], fibre=FibreSensors.at((*PLACES, 900.0)))
    assert found.model == identify([inside], fibre=SENSORS).model
    assert "the sensor 900 mm from the tip is not in the tissue in any trial, and was not used" in found.remarks


def test_a_sensor_that_drifts_is_named_by_its_readings_outside_of_the_tissue() -> None:
    depth = np.linspace(-2.0, 120.0, 245)
    inside = (depth[:, None] > PLACES)[:, :, None]
    curvature = np.where(inside, TRUTH.curvatures([120.0], PLACES), 0.0)
    trial = record(curvature, 120.0).with_column("depth_mm", depth)
    assert not any("outside of the tissue" in each for each in identify([trial], fibre=SENSORS).remarks)
    warm = curvature.copy()
    warm[:, 2, 0] += np.linspace(0, 2e-3, len(depth))
    found = identify([record(warm, 120.0).with_column("depth_mm", depth)], fibre=SENSORS)
    (remark,) = (each for each in found.remarks if "outside of the tissue" in each)
    assert remark.startswith("the sensor 70 mm from the tip measures")


def test_the_command_writes_a_model_with_its_sensors(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    write_records([insertion(seed) for seed in range(2)], "shape.csv")
    arguments = ["identify", "shape", "shape.csv", "--sensors", "10,35,70,100", "--boundary", "60", "-o", "shape.toml"]
    assert needleplan(*arguments).returncode == 0
    file = ModelFile.read("shape.toml")
    assert isinstance(file.model, LayeredShape)
    assert file.fibre
    assert file.fibre.from_tip_mm == PLACES
    assert file.estimates["second_per_mm"].identified
    refused = needleplan("identify", "curvature", "shape.csv", "--sensors", "10")
    assert refused.returncode == 2
    assert "is for shape, not for curvature" in refused.stderr
