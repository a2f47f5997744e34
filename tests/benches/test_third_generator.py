"""The third generator of blind data: its figures against independent computations."""

import ast
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.linalg import toeplitz

from needleplan.models import ModelFile
from needleplan.recording import read_records

FOLDER = Path(__file__).parents[2] / "benches" / "python"
sys.path.insert(0, str(FOLDER))

from third_generator import KINDS, LIBRARIES, kind_of, make, strata_of  # noqa: E402
from third_generator_documented import DOCUMENTED_EFFECTS  # noqa: E402
from third_generator_law import (  # noqa: E402
    DOCUMENTED,
    Trial,
    deviations,
    documented_force,
    other_law,
    pieces,
    plastic,
    powered,
)  # fmt: skip
from third_generator_motion import Legs, paths  # noqa: E402
from third_generator_outside import OUTSIDE_EFFECTS  # noqa: E402
from third_generator_size import STRATA, SensorNoise, Sizing, Tissue, sensitivities, tissue_modes  # noqa: E402
from third_generator_state import HiddenEffect, affine_scan, simulate  # noqa: E402

BASE = {"friction": 0.035, "cutting": 0.5, "onset_mm": 5.0, "presliding_mm": 0.2}
AXES = {
    "depth", "time", "speed", "phase", "hold", "force", "direction", "acceleration", "position wave",
}  # fmt: skip


def a_trial(rate_hz: int = 50, heterogeneity: float = 0.0, number: int = 0) -> Trial:
    """Insert, rest, retract, insert again, at three speeds."""
    legs = Legs(200.0)
    legs.stay(0.5)
    legs.go(20.0, 8.0)
    legs.stay(0.5)
    legs.go(12.0, 4.0)
    legs.go(30.0, 12.0)
    legs.go(10.0, 12.0)
    rng = np.random.default_rng([8, number])
    both = [deviations(rng, heterogeneity, 5.0) for _ in range(2)]
    return Trial("a", "train", number, rate_hz, legs.path(rate_hz), BASE, *both)


def test_equal_arguments_give_equal_data() -> None:
    first, again, other = make(4, 7), make(4, 7), make(4, 8)
    assert first.truth == again.truth
    assert first.nominal == again.nominal
    for (name, role, columns), once_more in zip(first.records, again.records, strict=True):
        assert (name, role) == once_more[:2]
        assert all(np.array_equal(columns[key], once_more[2][key]) for key in columns)
    assert first.nominal != other.nominal


def test_given_choices_are_kept() -> None:
    truth = make(1, 0, kind="pair", motion="cycles", rate_hz=50, heterogeneity=0.03, base="other").truth
    assert (truth["kind"], truth["motion"], truth["rate_hz"]) == ("pair", "cycles", 50)
    assert (truth["heterogeneity"], truth["base"], len(truth["hidden"])) == (0.03, "other", 2)
    with pytest.raises(ValueError, match="must be one of"):
        make(1, 0, rate_hz=60)


def test_documented_base_is_a_fine_integration_of_its_equations() -> None:
    trial, fine_hz = a_trial(), 20_000
    spline = CubicSpline(trial.path.time_s, trial.path.depth_mm)
    times = np.arange(int(trial.path.time_s[-1] * fine_hz) + 1) / fine_hz
    depth, z, force = spline(times), 0.0, np.zeros(times.size)
    for k, move in enumerate(np.diff(depth).tolist(), start=1):
        middle = z + (move - abs(move) * z) / BASE["presliding_mm"] / 2
        z += (move - abs(move) * middle) / BASE["presliding_mm"]
        inside = max(depth[k], 0.0)
        tip = BASE["cutting"] * (1 - np.exp(-inside / BASE["onset_mm"]))
        force[k] = BASE["friction"] * inside * z + tip * (1 + z) / 2
    half = fine_hz // trial.rate_hz // 2
    means = (force[1:] + force[:-1]) / 2
    samples = [means[k - half : k + half].mean() for k in range(2 * half, times.size - half, 2 * half)]
    assert np.abs(documented_force(trial, BASE)[1 : 1 + len(samples)] - samples).max() < 1e-3
    assert np.abs(simulate(trial, DOCUMENTED, ()) - documented_force(trial, BASE)).max() < 1e-12


@pytest.mark.parametrize(
    "noise", [SensorNoise(0.02, 0.0, 0.0), SensorNoise(0.01, 0.6, 1.0), SensorNoise(0.01, 0.5, 0.6)]
)
def test_noncentrality_is_that_of_dense_matrices(noise: SensorNoise) -> None:
    trial = a_trial()
    sizing = Sizing([trial, trial], DOCUMENTED, noise, [BASE, BASE])
    time_s = trial.points(trial.path.time_s)
    signal = 0.03 * np.where(time_s > 0.5, np.sin(2 * time_s) + (time_s > 4), 0.0)
    lags = np.arange(time_s.size)
    covariance = noise.rms**2 * toeplitz(noise.share * noise.correlation**lags + (1 - noise.share) * (lags == 0))
    inverse, by = np.linalg.inv(covariance), sensitivities(trial, BASE)
    absorbed = by @ np.linalg.solve(by.T @ inverse @ by, by.T @ inverse @ signal)
    expected = 2 * (signal - absorbed) @ inverse @ (signal - absorbed)
    assert sizing.noncentrality([signal, signal]) == pytest.approx(expected, rel=1e-4)


def test_noncentrality_with_tissue_is_that_of_dense_matrices() -> None:
    trial, noise, tissue = a_trial(), SensorNoise(0.01, 0.0, 0.0), Tissue(0.1, 5.0)
    sizing = Sizing([trial], DOCUMENTED, noise, [BASE], tissue)
    signal = 0.05 * np.sin(trial.points(trial.path.time_s))
    modes, by = tissue_modes(trial, DOCUMENTED, tissue), sensitivities(trial, BASE)
    kept = np.linalg.svd(by.T)[2][4:]  # white noise: the complement of the base is a plain projection
    covariance = kept @ (noise.rms**2 * np.eye(len(signal)) + modes @ modes.T) @ kept.T
    expected = kept @ signal @ np.linalg.solve(covariance, kept @ signal)
    assert sizing.noncentrality([signal], with_tissue=True) == pytest.approx(expected, rel=1e-6)
    assert sizing.noncentrality([signal], with_tissue=True) < sizing.noncentrality([signal])


def test_tissue_modes_have_the_spread_of_simulated_tissue() -> None:
    tissue, plain = Tissue(0.1, 5.0), simulate(a_trial(), DOCUMENTED, ())
    drawn = [simulate(a_trial(50, 0.1, number), DOCUMENTED, ()) - plain for number in range(300)]
    spread, modes = np.std(drawn, axis=0), tissue_modes(a_trial(), DOCUMENTED, tissue)
    at = np.flatnonzero(a_trial().points(a_trial().path.depth_mm) > 5)[::20]
    assert np.median(np.sqrt((modes**2).sum(axis=1))[at] / spread[at]) == pytest.approx(1, abs=0.1)


@pytest.mark.parametrize("effect", DOCUMENTED_EFFECTS, ids=lambda effect: effect.name)
def test_documented_effect_vanishes_at_size_zero(effect: object) -> None:
    trial, rng = a_trial(), np.random.default_rng(3)
    numbers = effect.draw(rng, 30.0)  # type: ignore[attr-defined]
    plain = simulate(trial, DOCUMENTED, ())
    assert np.abs(simulate(trial, DOCUMENTED, [HiddenEffect(effect, 0.0, numbers)]) - plain).max() < 1e-12  # type: ignore[arg-type]
    large = simulate(trial, DOCUMENTED, [HiddenEffect(effect, effect.high / 4, numbers)])  # type: ignore[attr-defined,arg-type]
    assert np.abs(large - plain).max() > 1e-3


def test_outside_effects_reach_every_axis_under_names_of_their_own() -> None:
    assert {effect.axis for effect in OUTSIDE_EFFECTS} == AXES
    assert len(OUTSIDE_EFFECTS) >= 15
    assert len(LIBRARIES) == len(OUTSIDE_EFFECTS) + len(DOCUMENTED_EFFECTS)
    for effect in (*OUTSIDE_EFFECTS, *DOCUMENTED_EFFECTS):
        assert {effect.axis, *effect.also} <= AXES
        assert effect.axis not in effect.also


def test_kinds_and_strata_have_their_shares() -> None:
    kinds = [kind_of(2, index) for index in range(40, 60)]
    assert [kinds.count(kind) for kind in KINDS] == [5, 8, 3, 4]
    assert sorted(strata_of(2, index, 1)[0] for index in range(10, 15)) == list(STRATA)


@pytest.mark.parametrize("index", range(3))
def test_single_effect_has_the_noncentrality_of_its_stratum(index: int) -> None:
    truth = make(6, index, kind="single", rate_hz=50, heterogeneity=0.0).truth
    (hidden,), ((low, high),) = truth["hidden"], truth["strata"]
    assert truth["gave_way"] < 12
    assert low <= hidden["noncentrality"] <= high


def test_strata_counted_with_tissue_hold_with_tissue() -> None:
    truth = make(6, 1, kind="single", rate_hz=50, heterogeneity=0.1, counted="tissue").truth
    (hidden,), ((low, high),) = truth["hidden"], truth["strata"]
    assert truth["gave_way"] < 12
    assert low <= hidden["noncentrality_with_tissue"] <= high


def test_noise_has_its_spread_and_its_colour() -> None:
    noise = SensorNoise(0.01, 0.6, 0.7)
    drawn = noise.draw(np.random.default_rng(0), 200_000)
    near = np.mean(drawn[1:] * drawn[:-1]) / np.mean(drawn**2)
    assert drawn.std() == pytest.approx(0.01, rel=0.02)
    assert near == pytest.approx(0.42, abs=0.02)
    white = noise.whitened(drawn)
    assert white.std() == pytest.approx(1, rel=0.02)
    assert abs(np.mean(white[1:] * white[:-1])) < 0.01


def test_scan_is_the_recursion() -> None:
    rng = np.random.default_rng(1)
    keep, add = rng.uniform(0, 1, 1000), rng.normal(size=1000)
    y, expected = 0.5, []
    for a, b in zip(keep, add, strict=True):
        y = a * y + b
        expected.append(y)
    assert np.abs(affine_scan(keep, add, 0.5) - expected).max() < 1e-12


def test_reversals_do_not_depend_on_how_a_travel_is_divided() -> None:
    travel = np.linspace(0, 3, 31)
    for law in (DOCUMENTED.reversal, powered(1.3), powered(0.7), plastic):
        whole = law(1.0, -0.8, travel)
        assert whole[0] == pytest.approx(-0.8)
        assert np.all(np.diff(whole) >= 0)
        assert law(1.0, float(whole[10]), travel[:21]) == pytest.approx(whole[10:])
    assert [way for _, _, way in pieces(np.array([0.0, 1, 1, 2, 1, 1, 0, 3]))] == [1, -1, 1]


@pytest.mark.parametrize("seed", range(4))
def test_other_laws_agree_with_the_documented_one_up_to_some_percent(seed: int) -> None:
    law, _ = other_law(np.random.default_rng(seed))
    truth = make(seed, 1, kind="none", rate_hz=50, base="other").truth["base_detail"]
    assert 0.002 < truth["rms_share"] < 0.08
    assert law.tip(np.array([200.0]), 0.5, 5.0)[0] == pytest.approx(0.5, rel=0.05)


@pytest.mark.parametrize("motion", ["rich", "one_speed", "cycles"])
def test_motions_are_smooth_and_end_at_rest(motion: str) -> None:
    for _, path in paths(np.random.default_rng(2), motion, 50.0, 100, 3):
        assert 40 < path.depth_mm.max() < 52
        assert np.abs(path.velocity_mm_s).max() < 20
        assert path.velocity_mm_s[0] == path.velocity_mm_s[-1] == 0
        assert np.abs(np.gradient(path.depth_mm, path.time_s) - path.velocity_mm_s).max() < 0.2


@pytest.mark.slow
def test_written_sets_are_read_by_needleplan(tmp_path: Path) -> None:
    command = [
        sys.executable,
        FOLDER / "third_generator.py",
        "--out",
        tmp_path,
        "--sets",
        "1",
        "--seed",
        "9",
        "--rate",
        "50",
    ]
    subprocess.run(command, check=True, timeout=120)
    (folder,) = tmp_path.iterdir()
    truth = json.loads((folder / "truth.json").read_text())
    made = make(9, 0, rate_hz=50)
    assert truth == json.loads(json.dumps(made.truth))
    model = ModelFile.read(folder / "model.toml").model
    assert {key: getattr(model, key) for key in made.nominal} == made.nominal
    records = [record for file in folder.glob("*.csv") for record in read_records(file)]
    assert sorted(record.role.value for record in records) == sorted(role for _, role, _ in made.records)
    for name, _, columns in made.records:
        (record,) = [each for each in records if each.trial == name]
        assert np.abs(record["force_n"] - columns["force_n"]).max() < 1e-6


def test_generator_does_not_import_needleplan() -> None:
    for file in FOLDER.glob("third_generator*.py"):
        for node in ast.walk(ast.parse(file.read_text())):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            assert not any(name.startswith("needleplan") for name in names), file
        assert len(file.read_text().splitlines()) < 300
