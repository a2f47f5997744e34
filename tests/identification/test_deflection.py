"""From records of deflection and axial force to curvature, F0 and kf.

The records come from the march of a finite needle with all axial terms, not from the path law that is fitted.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure

from needleplan.errors import DataError
from needleplan.identification.deflection import NEEDLE, TISSUE, identify
from needleplan.models import TipPath
from needleplan.models.deflection import AxialOffset, ElasticTissue, march
from needleplan.signals import Array, Record, Role

FORCE_N, OFFSET_N, SPEED_MM_S = 0.05, 0.06, 15.0
STEP_MM = 0.5


def inserted(force_n: float, flip_mm: float | None = None, end_mm: float = 80.0) -> tuple[Array, Array, Array]:
    depth = STEP_MM * np.arange(round(end_mm / STEP_MM) + 1)
    force = force_n * np.minimum(depth / 15, 1) ** 2
    angle = np.where(depth > flip_mm, math.pi, 0.0) if flip_mm else np.zeros_like(depth)
    path = march(NEEDLE, TISSUE, force, STEP_MM, SPEED_MM_S, bevel=np.cos(angle))
    return depth, path.tip_mm, angle


def record(
    force_n: float = FORCE_N, seed: int = 0, noise_mm: float = 0.03, flip_mm: float | None = None,
    end_mm: float = 80.0, role: Role = Role.TRAIN,
) -> Record:  # fmt: skip
    depth, tip, angle = inserted(force_n, flip_mm, end_mm)
    random = np.random.default_rng(seed)
    time = np.arange(0, end_mm / SPEED_MM_S, 0.02)
    at = SPEED_MM_S * time
    lateral = 0.4 - 0.01 * at + np.interp(at, depth, tip) + noise_mm * random.standard_normal(at.size)
    viscous = TISSUE.friction_n_s_mm2 * SPEED_MM_S * at
    cutting = np.interp(at, depth, force_n * np.minimum(depth / 15, 1) ** 2) * math.sin(NEEDLE.bevel_angle_rad)
    return Record({
        "time_s": time, "depth_mm": at, "velocity_mm_s": np.full_like(at, SPEED_MM_S), "y_mm": lateral,
        "force_n": OFFSET_N + viscous + cutting + 0.003 * random.standard_normal(at.size),
        "angle_rad": np.interp(at, depth, angle),
    }, f"trial {seed}", role)  # fmt: skip


def without(given: Record, *names: str) -> Record:
    return Record({key: values for key, values in given.columns.items() if key not in names}, given.trial, given.role)


def test_one_record_gives_the_curvature_and_no_more() -> None:
    found = identify([without(record(), "force_n")], needle=NEEDLE, tissue=TISSUE)
    depth, tip, _ = inserted(FORCE_N)
    parabola = np.polyfit(depth[depth > 20], tip[depth > 20], 2)
    assert found.estimates["curvature"].value == pytest.approx(2 * parabola[0], rel=0.08)
    # The base is felt: the needle bends a fifth more than a deep one would, which is taken into account.
    force = found.estimates["cutting_force"]
    assert force.low < FORCE_N < force.high
    assert force.value == pytest.approx(FORCE_N, rel=0.1)
    assert found.estimates["curvature"].identified
    assert set(found.estimates) == {"curvature", "cutting_force", "slope", "offset"}
    assert any("kf is given, not identified" in each for each in found.remarks)
    assert any("F0 and vf are not identified" in each for each in found.remarks)
    assert isinstance(found.model, TipPath)
    assert found.model.curvature_1_mm == pytest.approx(found.estimates["curvature"].value)
    assert found.scores[0] == ("RMSE", pytest.approx(0.03, rel=0.15), "mm")


@pytest.mark.parametrize(("soft_mm", "ratio", "rise_mm"), [(40.0, 3.0, 15.0), (60.0, 4.0, 25.0)])
def test_a_stiff_shaft_behind_a_soft_tip_is_taken_into_account(soft_mm: float, ratio: float, rise_mm: float) -> None:
    stepped = replace(NEEDLE, stiffness_steps=((soft_mm, ratio),))
    depth = STEP_MM * np.arange(161)
    path = march(stepped, TISSUE, FORCE_N * np.minimum(depth / rise_mm, 1) ** 2, STEP_MM, SPEED_MM_S)
    lateral = path.tip_mm + 0.01 * np.random.default_rng(0).standard_normal(depth.size)
    data = Record({"time_s": depth / SPEED_MM_S, "depth_mm": depth, "y_mm": lateral}, "stepped", Role.TRAIN)
    known, ignored = (
        identify([data], needle=each, tissue=TISSUE).estimates["cutting_force"] for each in (stepped, NEEDLE)
    )
    assert known.low < FORCE_N < known.high
    assert ignored.high < FORCE_N


def test_the_other_side_is_a_negative_curvature() -> None:
    mirrored = without(record(), "force_n")
    left, right = (
        identify([each]).estimates["curvature"] for each in (mirrored, mirrored.with_column("y_mm", -mirrored["y_mm"]))
    )
    assert left.value == pytest.approx(-right.value, rel=1e-4)
    assert left.low == pytest.approx(-right.high, rel=1e-3)


@pytest.mark.slow
def test_the_axial_force_gives_friction_and_its_offset() -> None:
    found = identify([record(seed=seed) for seed in range(3)], needle=NEEDLE, tissue=TISSUE)
    assert found.estimates["friction"].value == pytest.approx(TISSUE.friction_n_s_mm2, rel=0.02)
    offset = found.estimates["axial_offset"]
    assert offset.low < OFFSET_N < offset.high
    assert offset.value == pytest.approx(OFFSET_N, abs=0.003)
    assert 0 < offset.sd < 0.004


@pytest.mark.study
def test_a_known_offset_gives_the_stiffness() -> None:
    softer = ElasticTissue(TISSUE.stiffness_n_mm2 / 2, TISSUE.friction_n_s_mm2)  # wrong, and not believed
    records = [record(seed=seed) for seed in range(3)]
    found = identify(records, needle=NEEDLE, tissue=softer, axial_offset=AxialOffset(OFFSET_N, 5e-4))
    stiffness = found.estimates["stiffness"]
    assert stiffness.identified
    assert stiffness.low < TISSUE.stiffness_n_mm2 < stiffness.high
    assert stiffness.value == pytest.approx(TISSUE.stiffness_n_mm2, rel=0.6)  # the fourth power of a tenth
    vague = identify(records, needle=NEEDLE, tissue=softer, axial_offset=AxialOffset(OFFSET_N, 0.02))
    assert not vague.estimates["stiffness"].identified


def test_a_flip_gives_the_stiffness() -> None:
    found = identify([without(record(flip_mm=50.0), "force_n")], needle=NEEDLE, tissue=ElasticTissue(0.01))
    stiffness = found.estimates["stiffness"]
    assert stiffness.identified
    assert stiffness.value == pytest.approx(TISSUE.stiffness_n_mm2, rel=0.3)
    assert any("without experimental test" in each for each in found.remarks)


@pytest.mark.slow
def test_records_that_agree_and_records_that_do_not() -> None:
    same = identify([record(seed=seed) for seed in range(4)])
    apart = identify([record(0.03, 1), record(0.05, 2), record(0.07, 3)])
    (agree,), (disagree,) = (
        [each for each in found.findings if each.name == "agreement of records"] for found in (same, apart)
    )
    assert agree.p_value is not None
    assert agree.p_value > 0.01
    assert disagree.p_value is not None
    assert disagree.p_value < 1e-6
    assert apart.estimates["curvature"].sd > 5 * same.estimates["curvature"].sd


def test_held_out_records_are_scored() -> None:
    found = identify([record(seed=1), record(seed=2, role=Role.HOLDOUT)])
    name, value, unit = found.scores[-1]
    assert "1 held-out" in name
    assert (value, unit) == (pytest.approx(0.03, rel=0.2), "mm")


def test_records_too_short_are_named_and_left_out() -> None:
    short = record(seed=5, end_mm=25.0)
    with pytest.raises(DataError, match=r"trial 5|too short beyond 20 mm"):
        identify([short])
    found = identify([short, record(seed=1)])
    assert any("left out, trial 5" in each and "too short beyond 20 mm" in each for each in found.remarks)
    with pytest.raises(DataError, match="y_mm"):
        identify([without(record(), "y_mm")])
    with pytest.raises(DataError, match="depth in mm"):
        identify([record().with_column("depth_mm", record()["depth_mm"] / 1000)])


def test_a_straight_path_is_no_curvature() -> None:
    straight = without(record(1e-6, noise_mm=0.1), "force_n")
    found = identify([straight])
    assert any("cannot be told from zero" in each for each in found.remarks) or (
        abs(found.estimates["curvature"].value) < 1e-4
    )


def test_the_figure_is_drawn() -> None:
    found = identify([record(seed=1), record(seed=2)])
    figure = Figure()
    found.draw(figure)
    assert len(figure.axes) == 3
    assert [axes.get_ylabel() for axes in figure.axes][-1] == "axial force (N)"


def test_what_reading_said_and_what_was_not_used_is_remarked() -> None:
    given = record()
    noted = replace(given, notes=("3 rows were left out",))
    quiet = record(seed=1, role=Role.NOISE)
    found = identify([noted, quiet])
    assert "trial 0: 3 rows were left out" in found.remarks
    assert "trials of noise are not used here, 1 left out" in found.remarks
    assert {"whiteness", "trend with depth", "normality"} <= {each.name for each in found.findings}


def test_a_path_that_is_constant_to_the_last_bit_is_refused() -> None:
    given = record()
    with pytest.raises(DataError, match="y_mm = 0: is constant to the last bit"):
        identify([given.with_column("y_mm", np.zeros(len(given)))])
