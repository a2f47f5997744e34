"""From repeated insertions to the needle and the tip noise of a scenario."""

import math
from dataclasses import replace

import numpy as np
import pytest

from needleplan.errors import DataError, ScenarioError
from needleplan.identification import NoiseStatus
from needleplan.identification.scenario_part import scenario_part
from needleplan.models import arc_step
from needleplan.planning import plan
from needleplan.scenario import Layer, Needle, Scenario, Target, TipMotion, Tissue, Workspace
from needleplan.signals import Record, Role

PIECE_MM, PIECES = 0.25, 280


def scenario() -> Scenario:
    return replace(Scenario.read("brain"), motion=TipMotion(headings=72, tip_noise=(0.6, 0.2)))


def insertions(
    trials: int, *, deep_mm: float = 60.0, sd_rad: float = 0.004, seed: int = 0, incline_rad: float = 0.0
) -> list[Record]:
    """Trials with a radius of 60 mm down to x = 36 mm and `deep_mm` below; the heading wanders by sd_rad a piece."""
    random, records = np.random.default_rng(seed), []
    for number in range(trials):
        pose, points = (0.0, 0.0, incline_rad + random.normal(0, 0.02)), []
        for _ in range(PIECES):
            points.append(pose[:2])
            x, y, heading = arc_step(*pose, 1 / (60 if pose[0] < 36 else deep_mm), PIECE_MM)
            pose = (x, y, heading + random.normal(0, sd_rad))
        along, across = np.array(points).T + random.normal(0, 0.03, (2, PIECES))
        time = np.arange(PIECES) / 40
        records.append(Record({"time_s": time, "x_mm": along, "y_mm": across}, f"trial {number}"))
    return records


def test_the_radius_and_the_noise_of_a_wandering_heading_are_found_again() -> None:
    part = scenario_part(insertions(12), scenario())
    (whole,) = part.pieces
    assert 1 / whole.high_per_mm < 60 < 1 / whole.low_per_mm
    assert part.scenario.needle == Needle(1 / whole.curvature_per_mm)
    assert part.noise is not None
    assert part.noise.status is NoiseStatus.IDENTIFIED
    step_mm = 2 * math.pi / 72 * part.scenario.needle.curvature_radius_mm
    assert part.noise.low_rad < 0.004 * math.sqrt(step_mm / PIECE_MM) < part.noise.high_rad
    assert part.scenario.motion.tip_noise == part.noise.probabilities
    assert part.scenario.obstacles == scenario().obstacles
    lines = part.lines()
    assert [line for line in lines if line.startswith("[")] == ["[needle]", "[motion]"]
    assert f"tip_noise = {list(part.noise.probabilities)}" in lines


@pytest.mark.slow
@pytest.mark.parametrize(
    ("step_mm", "noise_step_deg", "headings"),
    [
        (3.0, 2.0, 40),
        *(
            pytest.param(*each, marks=pytest.mark.study)
            for each in ((None, None, 72), (2.0, None, 120), (None, 1.5, 60))
        ),
    ],
)
def test_executions_of_the_plan_scatter_like_the_insertions(
    step_mm: float | None, noise_step_deg: float | None, headings: int
) -> None:
    """Step, noise step and grid of headings are independent: the variance of the heading per mm is the needle's."""
    sd_rad = 0.004
    motion = TipMotion(headings=headings, step_mm=step_mm, tip_noise_step_deg=noise_step_deg)
    workspace, target = Workspace(120.0, 80.0), Target((110, 40), 2.0)
    before = replace(Scenario.read("brain"), motion=motion, obstacles=(), workspace=workspace, target=target)
    part = scenario_part(insertions(8, sd_rad=sd_rad), before)
    assert part.noise is not None
    assert part.noise.ok, part.noise.says
    found = part.scenario
    table = plan(replace(found, grid=replace(found.grid, spacing_mm=(2.0, 2.0), refinement=None)))
    length_mm = found.step_mm
    variances = []
    for seed in range(200):
        path = table.path((10.0, 40.0, 0.0), noise_seed=seed)
        turned = np.diff(np.unwrap(path.poses[:, 2]))
        turn_rad = length_mm / found.needle.curvature_radius_mm
        noise = turned[:-1] - np.where(path.poses[1:-1, 3] > 0, turn_rad, -turn_rad)
        variances.append(noise**2)
    per_mm = np.concatenate(variances).mean() / length_mm
    assert part.noise.low_rad**2 / length_mm < sd_rad**2 / PIECE_MM < part.noise.high_rad**2 / length_mm
    assert per_mm == pytest.approx(part.noise.sd_rad**2 / length_mm, rel=0.1)


@pytest.mark.parametrize("incline_rad", [0.0, -0.5])
def test_layers_have_radii_of_their_own(incline_rad: float) -> None:
    part = scenario_part(insertions(6, deep_mm=120.0, sd_rad=0.001, incline_rad=incline_rad), scenario(), layers=2)
    shallow, deep = part.pieces
    assert 1 / shallow.curvature_per_mm == pytest.approx(60, rel=0.1)
    assert 1 / deep.curvature_per_mm == pytest.approx(120, rel=0.2)
    (layer,) = part.scenario.needle.layers
    assert layer == Layer(deep.low_mm, 1 / deep.curvature_per_mm)
    assert layer.from_mm == pytest.approx(30 if incline_rad else 28, abs=5)
    assert "[[needle.layer]]" in part.lines()


def test_an_edge_in_x_is_where_the_path_is_there() -> None:
    # The path begins at -40 degrees: 36 mm along x are more of the path. Both pieces are one arc, and come out as such.
    part = scenario_part(insertions(1, sd_rad=0.0, incline_rad=-0.7), scenario(), layers=4)
    for piece in part.pieces:
        assert 1 / piece.high_per_mm < 60 < 1 / piece.low_per_mm
    assert part.noise is None
    assert any("one insertion says nothing about the tip noise" in each for each in part.remarks)


def test_what_the_scenario_had_is_kept_or_said_to_be_replaced() -> None:
    tissue = Tissue([(60, 5), (70, 5), (70, 15)], 33.0, "tumour")
    before = replace(scenario(), needle=Needle(40, (Layer(10, 50),)), tissues=(tissue,))
    quiet = Record({"time_s": np.arange(9.0), "y_mm": np.zeros(9)}, "quiet", Role.NOISE)
    part = scenario_part([*insertions(2, sd_rad=0.0), quiet], before)
    assert part.scenario.needle.layers == ()
    assert part.scenario.tissues == (tissue,)
    assert any("layers of the scenario were replaced" in each for each in part.remarks)
    assert any("radii of the tissues of the scenario stay" in each for each in part.remarks)
    assert part.noise is not None
    assert part.noise.status is NoiseStatus.NOT_SEPARABLE
    assert part.scenario.motion == before.motion
    assert any("it stays that of the scenario" in each for each in part.remarks)


def test_what_cannot_be_is_refused() -> None:
    with pytest.raises(DataError, match="layers = 11: must be 1 to 10"):
        scenario_part(insertions(2), scenario(), layers=11)
    with pytest.raises(DataError, match="no trial"):
        scenario_part([], scenario())
    with pytest.raises(DataError, match=r"contains a straight path, and a plan needs a radius; take fewer layers"):
        scenario_part(insertions(2, deep_mm=1e6, sd_rad=0.001), scenario(), layers=3)
    one, other = insertions(2)
    with pytest.raises(DataError, match="no common range"):
        scenario_part([one, other.with_column("x_mm", other["x_mm"] + 200)], scenario())
    narrow = replace(scenario(), workspace=replace(scenario().workspace, width_mm=200))
    far = [each.with_column("x_mm", each["x_mm"] + 300) for each in insertions(2, sd_rad=0.001)]
    with pytest.raises(ScenarioError, match=r"needle\.layer 1\.from_mm = .*must lie in the workspace, from 0 to 200"):
        scenario_part(far, narrow, layers=2)
