"""What follows from a model of a tip's path for planner and robot."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from needleplan.errors import ModelError
from needleplan.models import Model, ShaftAndTip, SpatialBicycle, in_plane, simulate
from needleplan.models.effects import AddedEffect, with_effect
from needleplan.reports.diagnosis import along_mm, corrected_plan
from needleplan.scenario import CurvaturePiece, Scenario, pieces_of
from needleplan.signals import Motion, Record

SCENARIO = Scenario.read("prostate")
BASE = SpatialBicycle(curvature_per_mm=0.01)


def model(name: str, **values: float) -> Model:
    return with_effect(BASE, AddedEffect(name, values))


def straight_after(turned: Model, roll_rad: float, depth_mm: float = 40.0) -> tuple[float, float]:
    """Return heading and elevation of a path at a roll, by simulation."""
    depth = np.linspace(0, depth_mm, 400)
    motion = Motion.sampled(depth / 5, depth, np.full(400, 5.0), np.full(400, roll_rad))
    tangent = simulate(turned, motion).states[3:6, -1]
    return math.atan2(tangent[1], tangent[0]), math.asin(tangent[2])


def test_a_layer_goes_to_the_planner() -> None:
    needle = corrected_plan(model("curvature_layer", size=0.5, depth_mm=30.0), SCENARIO).scenario.needle
    assert needle.curvature_radius_mm == pytest.approx(100, rel=0.01)
    (layer,) = needle.layers
    assert layer.curvature_radius_mm == pytest.approx(100 / 1.5, rel=0.01)
    assert 29 < layer.from_mm < 30.3  # the path is longer than its way along x


def test_a_layer_is_where_the_recordings_had_the_tip() -> None:
    depth = np.linspace(0, 70, 200)
    columns = {"time_s": depth, "depth_mm": depth, "x_mm": 3 + 0.9 * depth}
    found = corrected_plan(
        model("curvature_layer", size=0.5, depth_mm=30.0), SCENARIO, places=along_mm((Record(columns, "a"),))
    )
    assert found.scenario.needle.layers[0].from_mm == pytest.approx(27, abs=0.5)


def test_curvature_that_depends_on_the_speed_is_that_of_the_insertion() -> None:
    for velocity, share in ((5.0, 1.0), (10.0, 0.8), (2.5, 1.1)):
        found = corrected_plan(model("curvature_speed", size=-0.2), SCENARIO, velocity_mm_s=velocity)
        assert found.scenario.needle.curvature_radius_mm == pytest.approx(100 / share)
        assert not found.scenario.needle.layers


def test_a_lag_goes_to_the_torsion_and_a_tilt_to_the_robot() -> None:
    lagging = corrected_plan(model("torsional_lag", size=0.004), SCENARIO)
    assert lagging.torsion is not None
    assert lagging.torsion.lag_rad(165.0, 35.0) == pytest.approx(0.004 * 35, rel=0.1)
    assert lagging.options()["--torsion"].startswith("15000,")
    tilted = corrected_plan(model("misalignment", size=-0.03, direction_rad=math.pi), SCENARIO)
    assert tilted.heading_rad == pytest.approx(0.03, rel=1e-3)
    assert (tilted.torsion, tilted.scenario.needle.layers) == (None, ())


def test_a_needle_that_is_bent_goes_to_the_roll_of_the_stage() -> None:
    needle = model("pre_bend", size=0.002, direction_rad=1.0)
    bent = corrected_plan(needle, SCENARIO)
    assert bent.options() == {"--roll-left-deg": f"{math.degrees(bent.bends.roll_rad(1, 20.0)):.3f}"}
    assert bent.bends.roll_rad(-1, 20.0) == pytest.approx(math.pi + bent.turned_rad)
    assert straight_after(needle, bent.turned_rad)[1] == pytest.approx(0, abs=1e-3)
    sagging = corrected_plan(model("gravity", size=0.002, fading_mm=1e4), SCENARIO)
    assert sagging.options() == {}, "one angle for both sides does not help against what pulls to one"


@settings(deadline=None)
@given(size=st.floats(-0.006, 0.006), direction=st.floats(-3, 3), name=st.sampled_from(["pre_bend", "gravity"]))
def test_rolled_as_it_says_the_needle_stays_in_its_plane(size: float, direction: float, name: str) -> None:
    where = {"fading_mm": 1e4} if name == "gravity" else {"direction_rad": direction}
    bent = model(name, size=size, **where)
    found = in_plane(bent, 40.0)
    for bevel, side in ((1, found.left_per_mm), (-1, found.right_per_mm)):
        heading, elevation = straight_after(bent, found.roll_rad(bevel, 20.0))
        assert elevation == pytest.approx(0, abs=2e-3)
        assert heading == pytest.approx(bevel * 40 * side.mean(), abs=2e-3)


def test_what_is_of_the_tracker_changes_no_plan() -> None:
    shown = corrected_plan(model("tracker_bias", size=1.0, direction_rad=0.0), SCENARIO)
    plain = corrected_plan(BASE, SCENARIO)
    assert (shown.torsion, shown.heading_rad, shown.scenario) == (None, 0.0, plain.scenario)


def test_other_models_have_no_path() -> None:
    with pytest.raises(ModelError, match="spatial_bicycle"):
        corrected_plan(ShaftAndTip(friction=0.01, cutting=0.4, onset_mm=4.0, presliding_mm=0.05), SCENARIO)
    with pytest.raises(ModelError, match="bend to both sides"):
        corrected_plan(model("entry_rupture", size=-5.0, length_mm=20.0), SCENARIO)


@settings(deadline=None)
@given(st.lists(st.tuples(st.floats(3, 20), st.floats(0.2, 2)), min_size=1, max_size=5))
def test_pieces_are_those_of_a_curvature_that_has_some(rounds: list[tuple[float, float]]) -> None:
    ends = np.cumsum([length for length, _ in rounds])
    along = np.arange(0.0, ends[-1], 0.5)
    bend = 0.01 * np.array([rounds[int(np.searchsorted(ends, at, side="right"))][1] for at in along])
    found = pieces_of(along, bend)
    assert found[0].low_mm == 0
    again = np.array([[each for each in found if each.low_mm <= at][-1].curvature_per_mm for at in along])
    assert np.sqrt(np.mean((again / bend - 1) ** 2)) < 0.15
    assert all(isinstance(each, CurvaturePiece) for each in found)
    assert np.all(np.diff([each.low_mm for each in found]) >= 2)
