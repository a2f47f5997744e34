"""Entry pose and predicted tip: known truth, and the coverage of the region."""

import numpy as np
import pytest

from needleplan.errors import DataError
from needleplan.identification import curvature, deflection
from needleplan.identification._insertion_path import PathShape, ShapeKind, entry_path, trace
from needleplan.models import Bicycle
from needleplan.signals import Record

DEPTH = np.linspace(5.0, 100.0, 96)
BEND, HEADING, OFFSET = 1 / 1500, 0.06, -0.3


def insertion(random: np.random.Generator, heading: float = HEADING, offset: float = OFFSET) -> Record:
    x, y, _ = trace(PathShape(), 0.0, np.array([offset, heading, BEND]), DEPTH)
    columns = {"time_s": DEPTH, "depth_mm": DEPTH, "x_mm": x, "y_mm": y + random.normal(0, 0.1, DEPTH.size)}
    return Record(columns, f"{random.integers(10**9)}")


def test_entry_pose_and_tip_are_found_again() -> None:
    random = np.random.default_rng(0)
    found = curvature.identify([insertion(random, HEADING + turn) for turn in (-0.004, 0.0, 0.004)], segments=1)
    heading, offset = found.estimates["heading_rad"], found.estimates["offset_mm"]
    assert heading.low < HEADING < heading.high
    assert offset.low < OFFSET < offset.high
    assert heading.between_sd == pytest.approx(0.004, rel=0.7)
    assert isinstance(found.model, Bicycle)
    assert (found.model.heading_rad, found.model.offset_mm) == (heading.value, offset.value)
    said = found.prediction
    assert said is not None
    true = trace(PathShape(), 0.0, np.array([OFFSET, HEADING, BEND]), np.array([said.depth_mm]))[1, 0]
    assert said.y_mm == pytest.approx(true, abs=0.3)
    assert said.y_region_mm[0] < true < said.y_region_mm[1]
    assert len(said.left_out) == 2
    assert said.mean_error_mm is not None
    assert 0.1 < said.mean_error_mm < 1.0


def test_the_region_of_one_insertion_is_that_of_usual_insertions() -> None:
    found = curvature.identify([insertion(np.random.default_rng(1))], at_mm=50.0)
    said = found.prediction
    assert said is not None
    assert said.depth_mm == 50.0
    assert 2 < said.y_region_mm[1] - said.y_region_mm[0] < 10
    assert "does not determine the scatter" in said.lines()[-1]
    assert said.left_out == ()
    assert found.estimates["heading_rad"].between_sd is None
    with pytest.raises(DataError, match="at_mm = -1: must be a length above 0 mm"):
        curvature.identify([insertion(np.random.default_rng(1))], at_mm=-1.0)


def test_a_depth_beyond_the_data_is_said_to_be_an_extrapolation() -> None:
    random = np.random.default_rng(2)
    found = curvature.identify([insertion(random), insertion(random)], segments=1, at_mm=150.0)
    assert any("it is an extrapolation" in each for each in found.remarks)


@pytest.mark.parametrize(
    ("shape", "values"),
    [
        (PathShape(ShapeKind.LAYERED, (40.0,)), (0.2, 0.05, 1 / 300, 1 / 900)),
        (PathShape(ShapeKind.SMOOTH, (0.0, 50.0, 100.0)), (0.2, 0.05, 1 / 300, 1 / 500, 0.0)),
    ],
)
def test_shapes_are_found_again(shape: PathShape, values: tuple[float, ...]) -> None:
    x, y, heading = trace(shape, 0.0, np.array(values), DEPTH)
    noise = np.random.default_rng(3).normal(0, 0.02, DEPTH.size)
    found = entry_path(np.column_stack([x, y + noise]), DEPTH, shape)
    assert np.all(np.abs(found.values - values) < 4 * np.sqrt(np.diagonal(found.covariance)))
    assert found.tip(100.0) == pytest.approx(y[-1], abs=0.03)
    turned = np.gradient(heading, DEPTH)
    assert shape.curvature(np.array(values[2:]), DEPTH[5:30]) == pytest.approx(turned[5:30], rel=0.05)


@pytest.mark.slow
def test_deflection_predicts_the_same_tip() -> None:
    random = np.random.default_rng(5)
    records = [insertion(random, HEADING + turn) for turn in (-0.004, 0.0, 0.004)]
    by_arc = curvature.identify(records, segments=1, skip_mm=20.0).prediction
    found = deflection.identify(records, skip_mm=20.0)
    assert found.prediction == by_arc
    slope = found.estimates["slope"]
    assert found.model is not None
    assert slope.value == pytest.approx(found.model.values()["slope"])
    assert slope.between_sd == pytest.approx(0.004, rel=0.7)
