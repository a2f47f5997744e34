"""The bicycle model whose curvature changes with the depth."""

import numpy as np
import pytest

from needleplan.errors import ModelError, ScenarioError
from needleplan.models import BetweenDepths, Bicycle, BicycleByDepth, Estimate, ModelFile, arc_step, simulate
from needleplan.scenario import Scenario, identified
from needleplan.signals import Motion

DEPTH = np.linspace(0.0, 80.0, 801)
MOTION = Motion.sampled(DEPTH, DEPTH)
LAYERS = BicycleByDepth(0.01, 0.05, -0.3, 0.002, depth_1_mm=30.0)


def test_one_curvature_is_the_bicycle() -> None:
    one = simulate(BicycleByDepth(0.01, 0.05, -0.3), MOTION).output
    assert one == pytest.approx(simulate(Bicycle(0.01, 0.05, -0.3), MOTION).output, abs=1e-12)


def test_layers_are_tangent_arcs() -> None:
    pose = arc_step(0.0, -0.3, 0.05, 0.01, 30.0)
    assert simulate(LAYERS, MOTION).output[-1] == pytest.approx(arc_step(*pose, 0.002, 50.0)[1], abs=1e-9)
    late = Motion.sampled(DEPTH[500:], DEPTH[500:])
    assert simulate(LAYERS, late).output[0] == pytest.approx(simulate(LAYERS, MOTION).output[500], abs=1e-9)


def test_a_linear_curvature_is_a_clothoid() -> None:
    model = BicycleByDepth(0.0, curvature_1_per_mm=0.008, depth_1_mm=80.0, between=BetweenDepths.LINEAR)
    turned = simulate(model, MOTION).states[1]
    assert turned == pytest.approx(0.0001 * DEPTH**2 / 2, abs=1e-9)


def test_the_planner_gets_layers_and_straight_parts() -> None:
    scenario = Scenario.read("phantom")
    straight = BicycleByDepth(0.01, curvature_1_per_mm=-1e-4, depth_1_mm=30.0)
    found = identified(ModelFile(straight))
    assert [each.curvature_per_mm for each in found.pieces] == [0.01, 0.0]
    if scenario.motion.step_mm is None:
        with pytest.raises(ScenarioError, match="step_mm"):
            scenario.with_curvature(found.pieces)
    smooth = BicycleByDepth(0.01, curvature_1_per_mm=0.002, depth_1_mm=80.0, between=BetweenDepths.LINEAR)
    pieces = identified(ModelFile(smooth)).pieces
    assert len(pieces) == 8
    assert np.all(np.diff([each.curvature_per_mm for each in pieces]) < 0)


def test_a_first_part_may_be_straight() -> None:
    model = BicycleByDepth(0.0, curvature_1_per_mm=0.01, depth_1_mm=30.0)
    found = identified(ModelFile(model))
    from dataclasses import replace

    base = Scenario.read("four_obstacles")
    scenario = replace(base, motion=replace(base.motion, step_mm=4.0)).with_curvature(found.pieces)
    assert scenario.needle.curvature_radius_mm == pytest.approx(100.0)
    assert [each.curvature_radius_mm for each in scenario.needle.layers] == [np.inf, pytest.approx(100.0)]


def test_a_path_that_may_be_straight_everywhere_is_refused() -> None:
    unsure = Estimate(0.01, 0.01, -0.01, 0.03, "1/mm", identified=False)
    with pytest.raises(ModelError, match="is not identified at any depth"):
        identified(ModelFile(LAYERS, {"curvature_per_mm": unsure, "curvature_1_per_mm": unsure}))
