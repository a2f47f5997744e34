"""Where a gap is, and the shape of what no effect explains."""

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import TransferFunction, lsim

from needleplan.diagnosis import (
    Curve,
    Curves,
    Diagnosis,
    GapAxis,
    Library,
    MotionPhase,
    Verdict,
    diagnose,
    motion_phases,
    residuals_of,
)
from needleplan.diagnosis._gap import axis_values
from needleplan.errors import ModelError
from needleplan.models import simulate
from needleplan.models.effects import SIZE, Effect, effect_named, known_effects, register_file
from needleplan.reports.diagnosis import effect_file_text
from needleplan.signals import Array, Motion, Record, Role, insertion_cycles
from tests.diagnosis.trials import BASE, RATE_HZ, coloured, motion, recordings
from tests.models.effects import test_contract

LENGTH_MM = 3.7
LIBRARY = Library([effect_named(name) for name in ("viscous", "inertia")], BASE)


@pytest.mark.slow
def test_a_gap_is_found_where_it_is() -> None:
    hidden = {"bump": {SIZE: 0.3, "depth_mm": 40.0, "width_mm": 2.0}}
    found = diagnose(BASE, recordings(hidden, seed=3), library=Library([effect_named("bump")], BASE))
    assert found.names == ("bump",)
    depths = [each for each in found.where if each.axis == "depth_mm"]
    worst = depths[0]
    low, high = (float(word) for word in worst.label.split(" mm")[0].split(" to "))
    assert low <= 41
    assert high >= 39
    assert worst.p_value < 0.01
    assert sum(each.share for each in depths) == pytest.approx(1.0)


@pytest.mark.study
def test_without_a_gap_few_parts_are_called_large() -> None:
    called, every = 0, []
    for seed in range(6):
        found = diagnose(BASE, recordings(seed=seed), library=LIBRARY)
        called += sum(each.p_value <= 0.01 for each in found.where)
        every += [float(np.mean(each**2)) for each in residuals_of(found.nothing)]
    assert called <= 3  # of 6 data sets with 5 axes each, 0.3 are expected
    assert np.mean(every) == pytest.approx(1.0, abs=0.1)


def test_phases() -> None:
    found = motion_phases(insertion_cycles(30.0, 5.0, dwell_s=1.0, rate_hz=50))
    assert {*found.tolist()} == {MotionPhase.ADVANCE, MotionPhase.DWELL, MotionPhase.REVERSAL, MotionPhase.RETRACTION}
    assert found[100] == MotionPhase.ADVANCE
    assert found[-100] == MotionPhase.RETRACTION
    time_s = np.arange(1000) / 100
    swing = Motion.sampled(time_s, 20 * np.sin(2 * time_s))
    found, turns = motion_phases(swing), np.flatnonzero(np.diff(swing.direction[1:])) + 2
    assert swing.direction[turns].tolist() == [-1, 1, -1, 1, -1, 1]
    assert all(MotionPhase.REVERSAL in found[turn : turn + 20] for turn in turns)


def test_values_along_a_period_are_depths() -> None:
    time_s = np.arange(5.0)
    path = Motion.sampled(time_s, 10 * time_s)
    assert axis_values(GapAxis.PERIOD, path, time_s).tolist() == path.depth_mm.tolist()


def test_values_along_the_acceleration_are_accelerations() -> None:
    time_s = np.linspace(0.0, 2.0, 201)
    braking = Motion.sampled(time_s, 10 * time_s - 2 * time_s**2)
    found = axis_values(GapAxis.ACCELERATION, braking, time_s)
    np.testing.assert_allclose(found[3:-3], -4.0, atol=1e-6)


def wave(path: Motion) -> Array:
    return np.asarray(0.04 * np.sin(2 * np.pi * np.maximum(path.depth_mm, 0) / LENGTH_MM))


def swing(path: Motion) -> Array:
    """Return the force of a slack holder of 0.6 kg, a pendulum of 3 Hz, when the stage accelerates."""
    pendulum = TransferFunction([0.6e-3], [1 / (2 * np.pi * 3) ** 2, 2 * 0.05 / (2 * np.pi * 3), 1])
    return np.asarray(lsim(pendulum, np.gradient(path.velocity_mm_s, path.time_s), path.time_s)[1])


def drying(path: Motion) -> Array:
    return np.asarray(1e-3 * np.maximum(path.depth_mm, 0) * path.direction * np.sqrt(path.time_s / 20))


def step(path: Motion) -> Array:
    return np.where(path.time_s > 12.3, -0.06, 0.0)


def diagnosed(gap: Callable[[Motion], Array]) -> Diagnosis:
    generator = np.random.default_rng(5)
    found = []
    for number, role in enumerate((Role.TRAIN, Role.TRAIN, Role.HOLDOUT)):
        path = motion(number)
        force = simulate(BASE, path).output + gap(path) + coloured(generator, len(path))
        columns = {"time_s": path.time_s, "depth_mm": path.depth_mm, "velocity_mm_s": path.velocity_mm_s}
        found.append(Record({**columns, "force_n": force}, f"trial {number}", role))
    time = np.arange(1500) / RATE_HZ
    still = {"time_s": time, "depth_mm": np.full(1500, -5.0), "force_n": coloured(generator, 1500)}
    return diagnose(BASE, [*found, Record(still, "noise", Role.NOISE)], library=LIBRARY)


@pytest.fixture(scope="module")
def slipped() -> Diagnosis:
    return diagnosed(step)


@pytest.fixture(scope="module")
def course(slipped: Diagnosis) -> Curves:
    assert slipped.course is not None
    return slipped.course


@pytest.mark.slow
@pytest.mark.parametrize(
    ("gap", "axis"),
    [
        (wave, GapAxis.PERIOD),
        pytest.param(swing, GapAxis.ACCELERATION, marks=pytest.mark.slow),
        pytest.param(drying, GapAxis.TIME, marks=pytest.mark.slow),
    ],
)
def test_a_gap_that_no_effect_explains_has_its_axis(gap: Callable[[Motion], Array], axis: GapAxis) -> None:
    found = diagnosed(gap)
    assert (found.verdict, found.decision.axis) == (Verdict.UNKNOWN, axis)
    assert found.course is not None
    assert found.course.axis is axis


@pytest.mark.slow
def test_a_step_in_time_is_unknown_and_its_curve_knows_where_it_does_not(slipped: Diagnosis, course: Curves) -> None:
    assert (slipped.verdict, slipped.decision.axis) == (Verdict.UNKNOWN, GapAxis.TIME)
    assert not slipped.names
    (curve,) = course.curves
    early, late = curve.places < 11, curve.places > 14
    jump = curve.mean[late & curve.inside].mean() - curve.mean[early & curve.inside].mean()
    assert jump == pytest.approx(-0.06, abs=0.015)
    assert (curve.sd <= course.prior_sd * 1.001).all()
    assert curve.sd[~curve.inside].max() > 0.9 * course.prior_sd
    assert np.median(curve.sd[curve.inside]) < 0.5 * course.prior_sd


@pytest.fixture
def draft(course: Curves, tmp_path: Path) -> Iterator[Effect]:
    file = tmp_path / "effect_to_name.py"
    file.write_text(effect_file_text(course, "slip"))
    effect = register_file(str(file))
    yield effect
    del known_effects()[effect.name]


@pytest.mark.slow
def test_the_draft_keeps_the_contract_of_effects(draft: Effect) -> None:
    test_contract.test_it_says_what_it_is(draft)
    test_contract.test_size_zero_is_the_base_to_the_last_bit(draft)
    test_contract.test_columns_are_what_the_simulation_gains(draft)
    test_contract.test_memories_are_their_rates_integrated(draft)
    test_contract.test_a_run_goes_on_where_it_was(draft)
    test_contract.test_a_model_file_keeps_it(draft)
    test_contract.test_what_is_of_the_sensor_is_not_in_the_plant(draft)


@pytest.mark.slow
def test_the_draft_adds_what_was_described(draft: Effect, course: Curves) -> None:
    path, plain = motion(1), simulate(BASE, motion(1)).output
    added = simulate(draft.apply(BASE, {SIZE: draft.parameters[SIZE].typical}), path).output - plain
    (curve,) = course.curves
    wanted = np.interp(path.time_s, curve.places[curve.inside], curve.mean[curve.inside])
    np.testing.assert_allclose(added, wanted, atol=0.01 * np.abs(wanted).max())


def test_a_draft_along_the_acceleration_adds_its_table(tmp_path: Path) -> None:
    places = np.linspace(-50.0, 50.0, 25)
    curve = Curve("any", places, 2e-3 * places, np.full(25, 1e-3), np.ones(25, bool))
    file = tmp_path / "effect_to_name.py"
    file.write_text(effect_file_text(Curves(GapAxis.ACCELERATION, "mm/s2", (curve,), 0.1), "swing"))
    effect = register_file(str(file))
    try:
        path = motion(1)
        added = simulate(effect.apply(BASE, {SIZE: effect.parameters[SIZE].typical}), path).output
        wanted = 2e-3 * np.clip(np.gradient(path.velocity_mm_s, path.time_s), -50, 50)
        assert float(np.abs(wanted).max()) > 0.01
        np.testing.assert_allclose(added - simulate(BASE, path).output, wanted, atol=1e-3)
    finally:
        del known_effects()[effect.name]


def test_with_its_draft_a_gap_has_a_name(draft: Effect) -> None:
    generator = np.random.default_rng(6)
    path = motion(0)
    force = simulate(BASE, path).output + step(path) + coloured(generator, len(path))
    column = draft.columns(BASE, path, [{}])[:, 0]
    left = force - simulate(BASE, path).output
    fitted = float(column @ left / (column @ column))
    assert np.std(left - fitted * column) < 0.75 * np.std(left)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("import nothing_like_it", "cannot be created: ModuleNotFoundError"),
        ("EFFECT = 3", "must be defined as an Effect"),
        ("from needleplan.models.effects import FORCE_EFFECTS\nfrom dataclasses import replace\n"
         "EFFECT = replace(FORCE_EFFECTS[0])", "is the name of another effect"),
        ("raise SystemExit(3)", "cannot be created: SystemExit"),
    ],
)  # fmt: skip
def test_a_file_that_holds_no_effect_is_refused(text: str, says: str, tmp_path: Path) -> None:
    file = tmp_path / "mine.py"
    file.write_text(text)
    with pytest.raises(ModelError, match=says):
        register_file(str(file))
    with pytest.raises(ModelError, match="cannot be read"):
        register_file(str(tmp_path / "missing.py"))
