from dataclasses import replace

import numpy as np
import pytest

from needleplan.errors import DataError
from needleplan.identification import arc_curvature, curvature, path_curvature
from needleplan.models import arc_step
from needleplan.signals import Array, Record, Role
from tests.identification.arcs import arc, white


def trial(name: str, points: Array, **columns: Array) -> Record:
    time = np.arange(len(points)) / 40
    return Record({"time_s": time, "x_mm": points[:, 0], "y_mm": points[:, 1], **columns}, name)


@pytest.mark.slow
def test_insertions_that_differ_are_said_to_differ() -> None:
    random = np.random.default_rng(1)
    same = [trial(str(number), arc(1 / 300) + white(random)) for number in range(3)]
    found = curvature.identify(same)
    assert found.ok
    assert found.estimates["curvature_per_mm"].identified
    assert found.findings[0].p_value is not None
    assert found.findings[0].p_value > 0.05
    other = trial("other", arc(1 / 200) + white(random))
    apart = curvature.identify([*same, other])
    assert apart.findings[0].p_value is not None
    assert apart.findings[0].p_value < 1e-6
    assert any("the next one may lie outside" in each for each in apart.remarks)


def test_a_change_with_depth_is_found() -> None:
    random = np.random.default_rng(2)
    pose = arc_step(0.0, 0.0, 0.0, 1 / 100, 40.0)
    x, y, _ = arc_step(*pose, 1 / 400, np.linspace(0.2, 40, 160))
    points = np.concatenate([arc(1 / 100, 160, 40.0), np.column_stack([x, y])]) + white(random)
    change = curvature.identify([trial("kink", points)]).findings[0]
    assert change.p_value is not None
    assert change.p_value < 1e-3
    assert change.statistic == pytest.approx(1 / 400 - 1 / 100, rel=0.2)


def test_what_does_not_count_is_counted() -> None:
    random = np.random.default_rng(3)
    there = arc(1 / 300) + white(random)
    back = np.concatenate([there, there[::-4]])
    depth = np.concatenate([np.linspace(0, 80, 320), np.linspace(79, 0, 80)])
    quiet = Record({"time_s": np.arange(9.0), "y_mm": np.zeros(9)}, "quiet", Role.NOISE)
    found = curvature.identify([trial("a", back, depth_mm=depth), quiet], skip_mm=10.0)
    assert any("drawn back, do not count" in each for each in found.remarks)
    assert any("samples above 10 mm do not count" in each for each in found.remarks)
    assert "trials of noise are not used here, 1 left out" in found.remarks
    assert found.estimates["curvature_per_mm"].value == pytest.approx(1 / 300, rel=0.1)


def test_a_straight_path_is_said_to_be_possible() -> None:
    found = curvature.identify([trial("a", arc(0.0) + white(np.random.default_rng(4)))], segments=1)
    assert not found.estimates["curvature_per_mm"].identified
    assert any("a straight path is possible" in each for each in found.remarks)


def test_records_that_cannot_be_used() -> None:
    with pytest.raises(DataError, match="y_mm: is missing"):
        curvature.identify([Record({"time_s": np.arange(30.0), "depth_mm": np.arange(30.0)}, "a")])
    with pytest.raises(DataError, match="there is no trial"):
        curvature.identify([])
    with pytest.raises(DataError, match=r"short: .*too short"):
        curvature.identify([trial("short", arc(points=5))])


@pytest.mark.slow
def test_a_trial_held_out_judges_and_does_not_count() -> None:
    random = np.random.default_rng(5)
    train = [trial(name, arc(1 / 300) + white(random)) for name in ("a", "b", "c")]
    like, unlike = (
        replace(trial(name, arc(bend) + white(random)), role=Role.HOLDOUT)
        for name, bend in (("like", 1 / 300), ("unlike", 1 / 150))
    )
    alone, judged = curvature.identify(train), curvature.identify([*train, like, unlike])
    assert judged.estimates == alone.estimates
    verdicts = {each.name: each.p_value for each in judged.findings}
    assert (verdicts["held out, like"] or 0) > 0.05 > (verdicts["held out, unlike"] or 0)
    with pytest.raises(DataError, match="no trial to identify from: 1 held out"):
        curvature.identify([like])


def test_a_trial_held_out_is_no_contradiction_where_the_curvature_changes_with_depth() -> None:
    random = np.random.default_rng(8)
    pose = arc_step(0.0, 0.0, 0.0, 1 / 150, 40.0)
    x, y, _ = arc_step(*pose, 0.0, np.linspace(0.2, 40, 160))
    path = np.concatenate([arc(1 / 150, 160, 40.0), np.column_stack([x, y])])
    train = [trial(name, path + white(random)) for name in ("a", "b", "c")]
    held = replace(trial("like", path + white(random)), role=Role.HOLDOUT)
    judged = curvature.identify([*train, held], layers=2)
    assert judged.estimates["curvature_per_mm"].value == pytest.approx(1 / 150, rel=0.1)
    assert [each.p_value or 0.0 for each in judged.findings if each.name == "held out, like"] > [0.05]
    assert not any("a straight path is possible" in each for each in judged.remarks)


def test_what_an_arc_leaves_is_tested_like_every_residual() -> None:
    random = np.random.default_rng(6)
    found = curvature.identify([trial("arc", arc(1 / 300) + white(random))])
    bumpy = arc(1 / 300) + white(random)
    bumpy[:, 1] += 0.3 * np.sin(bumpy[:, 0])
    p_values = [
        next(each.p_value for each in some.findings if each.name == "whiteness")
        for some in (found, curvature.identify([trial("bumpy", bumpy)]))
    ]
    assert (p_values[0] or 0) > 0.01
    assert p_values[1] is not None
    assert p_values[1] < 1e-6


def test_a_path_that_is_constant_to_the_last_bit_is_refused() -> None:
    with pytest.raises(DataError, match=r"y_mm = 0\.3: is constant to the last bit"):
        curvature.identify([trial("dead", np.column_stack([np.linspace(0, 80, 320), np.full(320, 0.3)]))])


def test_a_trial_has_the_curvatures_of_its_points() -> None:
    """The path from the entry and the chain from the first point are one estimate."""
    found = curvature.insertion_of(trial("one", arc(1 / 300) + white(np.random.default_rng(8))), segments=2)
    whole = arc_curvature(found.points_mm)
    segments, changes = path_curvature(found.points_mm, [whole.high_mm / 2])
    for estimate, expected in ((found.whole, whole), *zip(found.segments, segments, strict=True)):
        assert estimate.curvature_per_mm == pytest.approx(expected.curvature_per_mm, rel=1e-3)
        assert estimate.low_per_mm == pytest.approx(expected.low_per_mm, rel=1e-2)
        assert estimate.high_per_mm == pytest.approx(expected.high_per_mm, rel=1e-2)
    assert found.changes[0].p_value == pytest.approx(changes[0].p_value, rel=0.05)


def test_a_segment_with_few_points_is_refused() -> None:
    points = arc(1 / 300) + white(np.random.default_rng(9))
    sparse = np.concatenate([points[: len(points) // 4], points[-1:]])
    with pytest.raises(DataError, match="holds 0 points; a segment needs at least 5"):
        curvature.insertion_of(trial("one", sparse), segments=3)
