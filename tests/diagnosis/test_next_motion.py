"""The next motion, against fits of each effect to the prediction of the other."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from needleplan.diagnosis import Diagnosis, Library, Verdict, diagnose
from needleplan.diagnosis.calibration import calibrate_trial
from needleplan.diagnosis.joint_fit import effects_output
from needleplan.diagnosis.next_motion import Limits, limits_of, next_motion, programs, separations
from needleplan.errors import DataError
from needleplan.models import Channel, simulate
from needleplan.models.effects import effect_named
from needleplan.reports.diagnosis.motion_file import motion_text
from needleplan.signals import Motion, Record, Role, lspb
from needleplan.simulation import Experiment, run_experiment
from tests.diagnosis.trials import BASE, NOISE_N, RATE_HZ, coloured

RIVALS = ("bias", "drift", "viscous", "friction_layer")


def even(speed_mm_s: float) -> Motion:
    return lspb([-2, 60, -2], [speed_mm_s, speed_mm_s], rate_hz=RATE_HZ)


@pytest.fixture(scope="module")
def wavering() -> Diagnosis:
    """Trials of half a minute that begin alike tell a false zero from one that moves only just."""
    generator = np.random.default_rng(5)
    hidden = effect_named("bias").apply(BASE, {"size": 0.007})
    found = []
    for name, speed, role in (("one", 5.0, Role.TRAIN), ("two", 5.0, Role.TRAIN), ("three", 6.0, Role.HOLDOUT)):
        path = even(speed)
        force = simulate(hidden, path).output + coloured(generator, len(path))
        columns = {"time_s": path.time_s, "depth_mm": path.depth_mm, "velocity_mm_s": path.velocity_mm_s}
        found.append(Record({**columns, "force_n": force}, name, role))
    time = np.arange(1500) / RATE_HZ
    still = {"time_s": time, "depth_mm": np.full(1500, -5.0), "force_n": coloured(generator, 1500)}
    library = Library([effect_named(name) for name in RIVALS], BASE)
    diagnosis = diagnose(BASE, [*found, Record(still, "noise", Role.NOISE)], library=library)
    assert diagnosis.verdict is Verdict.AMBIGUOUS
    return diagnosis


@pytest.mark.slow
def test_the_linear_prediction_agrees_with_a_fit_of_the_other_effect(wavering: Diagnosis) -> None:
    """Slow twin: the whitened square that a full calibration of the rival leaves of the other's prediction."""
    ranked = {each.newest.name: each for step in wavering.selection.rounds[-1:] for each in step.ranked}
    assert len(ranked) >= 2
    fast, slow = [], []
    for program in programs(Channel.FORCE, limits_of(wavering)):
        motion = program.motion(RATE_HZ)
        for pair in separations(wavering, motion):
            if pair.true not in ranked or pair.alternative not in ranked:
                continue
            true, alternative = ranked[pair.true], ranked[pair.alternative]
            base = true.trials[0].model
            shown = simulate(base, motion).output + effects_output(true.effects, base, motion)
            seen = shown - effects_output(alternative.effects, alternative.trials[0].model, motion)
            columns = {"time_s": motion.time_s, "depth_mm": motion.depth_mm, "velocity_mm_s": motion.velocity_mm_s}
            record = Record({**columns, "force_n": seen})
            noise, free = wavering.calibration.noise, wavering.calibration.free
            left = calibrate_trial(
                alternative.trials[0].model, record, noise, free, modes=False, about=alternative.trials[0].model
            )
            q, _ = np.linalg.qr(left.whitened.base_sensitivities)
            rest = left.whitened.residual - q @ (q.T @ left.whitened.residual)
            fast.append(pair.expected)
            slow.append(float(rest @ rest))
    # The other effect's parameters and the heterogeneity are free too: the prediction is smaller, but in this order.
    assert np.corrcoef(np.log1p(fast), np.log1p(slow))[0, 1] > 0.8
    assert np.median(np.array(fast) / np.array(slow)) < 1.2


def test_it_separates_more_than_the_last_motion_again(wavering: Diagnosis) -> None:
    proposed = next_motion(wavering)
    assert proposed is not None
    assert proposed.resolves >= proposed.repeated_resolves
    assert proposed.least > min(each.thresholds for each in proposed.repeated)
    assert {name for name, _, _ in proposed.considered} == {
        each.name for each in programs(Channel.FORCE, limits_of(wavering))
    }


def test_its_file_runs_in_the_lab_twin_along_the_motion(wavering: Diagnosis, tmp_path: Path) -> None:
    proposed = next_motion(wavering)
    assert proposed is not None
    file = tmp_path / "next_motion.toml"
    file.write_text(motion_text(proposed.program, proposed.why, proposed.role, BASE))
    done = run_experiment(Experiment.read(file)).record()
    assert done["depth_mm"].max() == pytest.approx(proposed.motion.depth_mm.max(), abs=0.1)
    assert done["time_s"][-1] == pytest.approx(proposed.motion.time_s[-1], rel=0.1)


@settings(deadline=None, max_examples=30)
@given(
    st.sampled_from([Channel.FORCE, Channel.TIP]), st.floats(8, 180), st.floats(0.5, 60), st.floats(-10, 2),
    st.floats(20, 500),
)  # fmt: skip
def test_programs_stay_within_the_limits(
    channel: Channel, deepest: float, fastest: float, shallowest: float, acceleration: float
) -> None:
    limits = Limits(deepest, fastest, shallowest, acceleration_mm_s2=acceleration)
    for program in programs(channel, limits):
        motion = program.motion(20.0)
        assert motion.depth_mm.max() <= deepest + 0.01
        assert motion.depth_mm.min() >= shallowest - 1e-6
        assert np.abs(motion.velocity_mm_s).max() <= fastest * (1 + 1e-6)
        assert motion.depth_mm[0] == shallowest


@pytest.mark.parametrize("wrong", [{"deepest_mm": 1.0}, {"deepest_mm": 60.0, "fastest_mm_s": float("nan")}])
def test_limits_without_room_are_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(DataError, match="must be"):
        Limits(**wrong)


def test_noise_is_what_it_is_said_to_be(wavering: Diagnosis) -> None:
    """The distances are in units of the noise: were that wrong, so would be they."""
    assert wavering.calibration.noise.rms == pytest.approx(NOISE_N, rel=0.1)
