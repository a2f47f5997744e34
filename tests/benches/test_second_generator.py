"""The second generator of insertions: its law, its noncentrality, its files."""

import json
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

BENCHES = Path(__file__).parents[2] / "benches" / "python"


@pytest.fixture(scope="module", autouse=True)
def on_path():
    sys.path.insert(0, str(BENCHES))
    yield
    sys.path.remove(str(BENCHES))


@pytest.fixture(scope="module")
def hidden():
    """A data set with one effect."""
    from second_generator_sets import make, wishes

    return make(wishes(4, 1, "single", 50, 0.0, "rich", "noise")[0])


def test_friction_is_coulombs_far_from_a_turn_and_a_spring_near_it():
    from second_generator_law import elasto_plastic, shares

    presliding = 0.2
    yields = shares(presliding)
    there, back = np.linspace(0, 20, 4001), np.linspace(20, 10, 2001)
    state = elasto_plastic(np.concatenate([there, back[1:]]), yields)
    assert state[4000] == 1.0
    assert state[-1] == -1.0
    assert yields.mean() == pytest.approx(presliding)
    # the spring: each element gives 1 over its yield displacement
    assert elasto_plastic(np.array([0.0, 0.001]), yields)[-1] == pytest.approx(0.001 * np.mean(1 / yields))
    # a whole reversal is near that of a Dahl bristle with the same presliding
    moved = 20 - back[1:]
    assert np.abs(state[4001:] - (2 * np.exp(-moved / presliding) - 1)).max() < 0.06


def test_minor_loops_close():
    from second_generator_law import elasto_plastic, shares

    turns = [0.0, 20.0, 19.9, 19.95, 19.9, 19.8]
    depth = np.concatenate([np.linspace(a, b, 200)[1:] for a, b in pairwise(turns)])
    state = elasto_plastic(depth, shares(0.2))
    first, again = 2 * 199 - 1, 4 * 199 - 1
    assert depth[first] == pytest.approx(depth[again])
    assert state[first] == pytest.approx(state[again], abs=1e-12)


def test_samples_are_means_over_their_interval():
    from second_generator_law import Insertion, Tissue
    from second_generator_motion import draw_motions

    (motion, _) = draw_motions(np.random.default_rng(0), "cycles", 1)
    slow, fast = (Insertion.of(motion, Tissue(0.035, 0.5, 4.0, 0.05), rate) for rate in (100, 500))
    slow, fast = (each.sampled(each.force) for each in (slow, fast))
    # an interval of 10 ms holds five intervals of 2 ms
    whole = min(len(slow), (len(fast) - 3) // 5)
    parts = np.array([fast[5 * each - 2 : 5 * each + 3].mean() for each in range(1, whole)])
    assert np.abs(slow[1:whole] - parts).max() < 1e-9


def test_depth_speed_and_acceleration_agree():
    from second_generator_motion import MOTIONS, draw_motions

    for kind in MOTIONS:
        for motion in draw_motions(np.random.default_rng(1), kind, 2):
            time = np.arange(0, motion.duration_s, 1e-3)
            depth, speed, _ = motion.at(time)
            assert np.abs(np.gradient(depth, time) - speed)[1:-1].max() < 0.15
            assert depth[-1] == pytest.approx(depth[0], abs=1e-3)


def test_noncentrality_is_the_mean_gain_of_monte_carlo(hidden):
    """Twice the log-likelihood gain of the known shape, base refitted, has the mean 1 + noncentrality."""
    from second_generator_noise import Noise, unabsorbed

    noise = Noise(hidden.noise.rms_n, 0.6)
    trial = hidden.bases[0]
    few = slice(0, None, trial.samples // 400)
    signal = (hidden.forces[0] - trial.sampled(trial.force))[few]
    base = trial.base_sensitivities()[few]
    signal *= np.sqrt(30 / unabsorbed(signal, base, noise))
    expected = unabsorbed(signal, base, noise)
    assert expected == pytest.approx(30)
    samples = len(signal)
    # the dense covariance of the noise, not the recursion of the generator
    lags = np.abs(np.subtract.outer(np.arange(samples), np.arange(samples)))
    root = np.linalg.cholesky(noise.rms_n**2 * noise.colour**lags)
    rng = np.random.default_rng(3)
    draws = np.linalg.solve(root, signal)[:, None] + rng.normal(size=(samples, 4000))
    small, _ = np.linalg.qr(np.linalg.solve(root, base / np.linalg.norm(base, axis=0)))
    large, _ = np.linalg.qr(np.linalg.solve(root, np.column_stack([base / np.linalg.norm(base, axis=0), signal])))
    gains = np.sum((large.T @ draws) ** 2, axis=0) - np.sum((small.T @ draws) ** 2, axis=0)
    error = gains.std() / np.sqrt(len(gains))
    assert gains.mean() - 1 == pytest.approx(expected, abs=4 * error)


def test_noise_has_its_variance_and_correlation():
    from second_generator_noise import Noise

    noise = Noise(0.02, 0.7)
    drawn = noise.draw(np.random.default_rng(0), 40_000)
    assert drawn.std() == pytest.approx(0.02, rel=0.05)
    assert np.corrcoef(drawn[1:], drawn[:-1])[0, 1] == pytest.approx(0.7, abs=0.02)
    assert noise.whitened(drawn).std() == pytest.approx(1, rel=0.02)


def test_every_kind_changes_the_force_and_has_an_axis():
    from second_generator_effects import LIBRARY
    from second_generator_hidden import Hidden, hidden_force
    from second_generator_kinds import OUTSIDE
    from second_generator_law import Insertion, Tissue
    from second_generator_motion import draw_motions
    from second_generator_planned import PLANNED

    (motion, _) = draw_motions(np.random.default_rng(5), "rich", 1)
    trial = Insertion.of(motion, Tissue(0.035, 0.5, 4.0, 0.1), 50)
    kinds = (*LIBRARY, *OUTSIDE, *PLANNED)
    assert len({each.name for each in kinds}) == len(kinds)
    assert len(LIBRARY) == 19
    assert len(OUTSIDE) >= 20
    for kind in kinds:
        force = hidden_force(trial, [Hidden(kind, kind.size, kind.draw(np.random.default_rng(0)))], 1)
        assert np.isfinite(force).all(), kind.name
        assert np.abs(force - trial.force).max() > 1e-4, kind.name
        assert kind.axis, kind.name


def test_the_same_seed_gives_the_same_data_and_another_one_does_not(hidden):
    from second_generator_sets import make, wishes

    again = make(wishes(4, 3, "single", 50, 0.0, "rich", "noise")[0])
    other = make(wishes(5, 1, "single", 50, 0.0, "rich", "noise")[0])
    assert again.truth == hidden.truth
    assert all(np.array_equal(a, b) for a, b in zip(again.measured, hidden.measured, strict=True))
    assert not np.array_equal(other.measured[0][:100], hidden.measured[0][:100])


@pytest.mark.slow
def test_the_command_line_accepts_the_files(tmp_path):
    script = [sys.executable, str(BENCHES / "second_generator.py")]
    options = ["--sets", "1", "--seed", "2", "--kind", "none", "--rate", "50", "--motion", "one_speed"]
    subprocess.run([*script, "--out", str(tmp_path), *options], check=True, capture_output=True)
    folder = tmp_path / "set_0000"
    files = [str(each) for each in sorted(folder.glob("*.csv"))]
    call = [sys.executable, "-m", "needleplan", "diagnose", str(folder / "model.toml"), *files]
    ran = subprocess.run([*call, "-o", str(tmp_path / "out")], check=False, capture_output=True, text=True)
    assert ran.returncode in (0, 1), ran.stderr
    found = json.loads((tmp_path / "out" / "diagnosis.json").read_text())
    roles = sorted(each["role"] for each in found["trials"])
    assert set(roles) >= {"train", "holdout"}
    assert not found["lacks"]
    assert not found["remarks"]
    assert json.loads((folder / "truth.json").read_text())["hidden"] == []
