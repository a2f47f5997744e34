"""The same insertions give the same path in identify curvature, identify deflection, --scenario and diagnose."""

from dataclasses import replace

import numpy as np
import pytest

from needleplan.identification import curvature, deflection
from needleplan.identification.scenario_part import scenario_part
from needleplan.models import simulate
from needleplan.reports.diagnosis.corrected_plan import identified_path
from needleplan.scenario import Scenario, TipMotion, identified
from needleplan.signals import Motion, Record

DEPTH = np.linspace(0.5, 90.0, 80)


def insertions(fading_mm: float, roll_rad: float = 0.0) -> list[Record]:
    """Three insertions with a curvature of 1/400 mm that fades, at a heading of 50 mrad that scatters."""
    random, found = np.random.default_rng(7), []
    for number in range(3):
        bend = np.exp(-DEPTH / fading_mm) / 400
        heading = 0.05 + random.normal(0, 0.004) + np.cumsum(bend) * (DEPTH[1] - DEPTH[0])
        along = np.concatenate([[0.0], np.cumsum(np.cos(heading[:-1]))]) * (DEPTH[1] - DEPTH[0]) + DEPTH[0]
        side = np.cumsum(np.sin(heading)) * (DEPTH[1] - DEPTH[0]) + random.normal(0, 0.05, DEPTH.size)
        columns = {"time_s": DEPTH / 5, "depth_mm": DEPTH, "x_mm": along, "y_mm": side}
        found.append(Record(columns | {"angle_rad": np.full(DEPTH.size, roll_rad)}, f"{number}"))
    return found


@pytest.mark.slow
@pytest.mark.parametrize("fading_mm", [1e6, 30.0])
def test_the_same_insertions_give_the_same_path_in_all_commands(fading_mm: float) -> None:
    records = insertions(fading_mm)
    found = curvature.identify(records)
    bent = deflection.identify(records)
    assert found.prediction is not None
    assert bent.prediction == found.prediction
    written = found.model_file(records)
    assert written is not None
    planned, diagnosed = identified(written), identified_path(records)
    assert diagnosed is not None
    assert replace(diagnosed, digest="") == replace(planned, digest="")
    motion = TipMotion(headings=90, step_mm=2.0, tip_noise=(1.0,))
    scenario = replace(Scenario.read("brain"), motion=motion)
    part = scenario_part(records, scenario, layers=None)
    expected = [each.curvature_per_mm for each in planned.pieces] or [planned.curvature_per_mm]
    assert bool(planned.pieces) == (fading_mm < 100)
    assert [max(each.curvature_per_mm, 0.0) for each in part.pieces] == pytest.approx(expected, rel=1e-9)
    starts = [each.low_mm for each in planned.pieces] or [0.0]
    assert [each.low_mm for each in part.pieces] == pytest.approx(starts, abs=0.1)


@pytest.mark.slow
def test_the_path_law_of_a_uniform_tissue_has_the_same_tip() -> None:
    records = insertions(1e6)
    found, bent = curvature.identify(records).prediction, deflection.identify(records).model
    assert found is not None
    assert bent is not None
    depth = np.linspace(0.0, found.depth_mm, 201)
    assert simulate(bent, Motion.sampled(depth, depth)).output[-1] == pytest.approx(found.y_mm, abs=0.15)


def test_a_rotated_needle_or_a_bevel_out_of_the_plane_has_no_path_in_the_plane() -> None:
    records = insertions(1e6)
    turned = [each.with_column("angle_rad", np.where(DEPTH > 40, np.pi, 0.0)) for each in records]
    assert identified_path(turned) is None
    assert identified_path(insertions(1e6, roll_rad=0.5)) is None
