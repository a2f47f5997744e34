"""Identification of friction: the models of chapter 3 on records whose making is known."""

import numpy as np
import pytest
from matplotlib.figure import Figure

from needleplan.errors import DataError
from needleplan.identification.friction import identify, traded
from needleplan.identification.friction_candidates import effective_samples
from needleplan.models import fit, simulate
from needleplan.models.friction import AveragedLuGre, Friction, LumpedLuGre, Profile, first_guess, steady
from needleplan.signals import Motion, Record, Role, Start, sinusoid
from needleplan_thesis.chapter3.published import model_ii, model_iii_b, passing_through

NOISE_N = 0.015


def recorded(model: Friction, motion: Motion, seed: int = 0, role: Role = Role.TRAIN) -> Record:
    noise = NOISE_N * np.random.default_rng(seed).standard_normal(len(motion))
    return Record({
        "time_s": motion.time_s, "depth_mm": motion.depth_mm, "velocity_mm_s": motion.velocity_mm_s,
        "force_n": simulate(model, motion).output + noise,
    }, "trial", role)  # fmt: skip


THROUGH = recorded(model_iii_b(2), passing_through(2, 3, 50))


@pytest.mark.slow
def test_the_model_that_made_the_data_is_chosen() -> None:
    found = identify([THROUGH], exponents=(0.5, 5.0))
    assert isinstance(found.model, AveragedLuGre)
    assert found.model.exponent == 5.0
    assert found.estimates["mu_c"].value == pytest.approx(model_iii_b(2).mu_c, rel=0.15)
    assert {name: value for name, value, _ in found.scores}["RMSE of the model"] == pytest.approx(0.015, rel=0.05)
    assert any("trade off" in each for each in found.remarks)
    figure = Figure()
    found.draw(figure)
    assert len(figure.axes) == 2


def test_with_the_tip_inside_the_normal_force_follows_the_length() -> None:
    truth = model_ii(2).with_values(profile=Profile.ISOSCELES)
    motion = sinusoid(offset_mm=38, amplitude_mm=25, frequency_hz=0.08, cycles=3, start=Start.MIDDLE, rate_hz=50)
    holdout = recorded(truth, sinusoid(
        offset_mm=30, amplitude_mm=20, frequency_hz=0.1, cycles=2, start=Start.MIDDLE, rate_hz=50
    ), 1, Role.HOLDOUT)  # fmt: skip
    found = identify([recorded(truth, motion), holdout], exponents=(5.0,))
    assert isinstance(found.model, LumpedLuGre)
    assert found.model.profile is Profile.ISOSCELES
    scores = {name: value for name, value, _ in found.scores}
    assert scores["II, Fn(L): RMSE held out"] == pytest.approx(NOISE_N, rel=0.1)
    assert scores["II: RMSE held out"] > 3 * NOISE_N


def test_only_the_models_that_were_asked_for() -> None:
    found = identify([THROUGH], models=["Karnopp", "II"])
    assert isinstance(found.model, LumpedLuGre)
    assert {name.split(":")[0] for name, _, _ in found.scores if ":" in name} == {"Karnopp", "II"}
    with pytest.raises(DataError, match="must be Karnopp, Karnopp by direction"):
        identify([THROUGH], models=["IV"])


def test_a_single_cycle_is_said_to_be_one() -> None:
    short = recorded(model_ii(2), passing_through(2, 1, 50))
    found = identify([short], models=["II"])
    assert any("nothing is held out" in each for each in found.remarks)
    assert any("0 instead of 1" in each for each in found.remarks)


def test_sigma2_is_traded_for_mu_c_and_alpha() -> None:
    """What the linearised covariance says is what other lambdas do: mu_c moves by half, the error by little."""
    guess = first_guess([THROUGH])
    right = fit(AveragedLuGre(**guess, exponent=5.0), THROUGH, mask=steady)
    wrong = fit(AveragedLuGre(**guess, exponent=0.5), THROUGH, mask=steady)
    assert traded(right) > 0.95
    assert wrong.rmse - right.rmse < 0.002
    assert abs(wrong.estimates["mu_c"].value / right.estimates["mu_c"].value - 1) > 0.1


def test_starts_from_the_data_reach_the_optimum_of_many_starts() -> None:
    once = fit(LumpedLuGre(**first_guess([THROUGH])), THROUGH, mask=steady)
    often = fit(LumpedLuGre(**first_guess([THROUGH])), THROUGH, mask=steady, starts=6, spread=0.8, seed=1)
    assert once.ok
    assert once.rmse == pytest.approx(often.rmse, rel=1e-6)


def test_effective_samples_of_a_moving_average() -> None:
    white = np.random.default_rng(0).standard_normal(20_000)
    assert effective_samples([white]) == pytest.approx(20_000, rel=0.1)
    averaged = np.convolve(white, np.full(8, 1 / 8), "valid")
    assert effective_samples([averaged]) == pytest.approx(20_000 / 8, rel=0.15)
    masked = np.where(np.arange(20_000) % 2 == 0, white, np.nan)
    assert effective_samples([masked, masked]) == pytest.approx(20_000, rel=0.1)


def test_the_mask_leaves_out_first_cycles_and_other_phases() -> None:
    counts = steady(THROUGH)
    assert not counts[THROUGH["time_s"] < 12.5].any()
    assert counts[THROUGH["time_s"] > 12.6].all()
    phases = tuple("in" if each > 0 else "out" for each in THROUGH["velocity_mm_s"])
    named = Record(THROUGH.columns, phase=phases)
    np.testing.assert_array_equal(steady(named, 0, ["in"]), THROUGH["velocity_mm_s"] > 0)
    with pytest.raises(DataError, match="must be one of in, out"):
        steady(named, 0, ["dwell"])
    with pytest.raises(DataError, match="leaves no sample"):
        steady(THROUGH, 3)


def test_records_without_friction_are_refused() -> None:
    with pytest.raises(DataError, match="at rest"):
        identify([THROUGH.with_column("depth_mm", np.full(len(THROUGH), 80.0))])
    with pytest.raises(DataError, match="no friction"):
        identify([THROUGH.with_column("force_n", np.zeros(len(THROUGH)))])
    with pytest.raises(DataError, match="no trial"):
        identify([recorded(model_ii(2), passing_through(2, 1, 50), role=Role.HOLDOUT)])


def test_a_start_is_guessed_without_slow_motion() -> None:
    time = np.arange(1000) / 100
    columns = {"time_s": time, "depth_mm": 5 * time, "velocity_mm_s": np.full(1000, 5.0), "force_n": 0.2 + 0.5 * time}
    guess = first_guess([Record(columns, "constant speed")])
    assert all(np.isfinite(value) for value in guess.values())
    assert guess["mu_s"] == pytest.approx(0.05 * (0.2 + 0.5 * time[499:501].mean()))
