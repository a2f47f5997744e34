"""The motion to measure next: its information against dense covariances, and what a further trial really decides."""

import math
from collections.abc import Sequence

import numpy as np
import pytest

from needleplan.diagnosis import (
    Diagnosis,
    Library,
    Limits,
    NextTrials,
    Settings,
    Verdict,
    diagnose,
    next_trials,
    programs,
)
from needleplan.diagnosis._next_motion import Prediction, _Shared
from needleplan.models import Channel, simulate
from needleplan.models.effects import effect_named
from needleplan.signals import Array, Motion, Record, Role, lspb
from tests.diagnosis.trials import BASE, coloured

FEW = Library([effect_named(name) for name in ("viscous", "stribeck", "relaxation", "bias")], BASE)
PROGRAMS = programs(Channel.FORCE, Limits(60.0))
VISCOUS = 1.1e-4


def trial_of(motion: Motion, generator: np.random.Generator, name: str, role: Role, size: float) -> Record:
    model = effect_named("viscous").apply(BASE, {"size": size}) if size else BASE
    columns = {"time_s": motion.time_s, "depth_mm": motion.depth_mm, "velocity_mm_s": motion.velocity_mm_s}
    return Record({**columns, "force_n": simulate(model, motion).output + coloured(generator, len(motion))}, name, role)


def at_one_speed(size: float) -> list[Record]:
    """Return three insertions at one speed, which do not separate viscous friction from relaxation."""
    generator = np.random.default_rng(3)
    motion = lspb([-2, 60, -2], [5, 5], dwells_s=[1, 0], rate_hz=50.0)
    found = [
        trial_of(motion, generator, f"trial {number}", role, size)
        for number, role in enumerate((Role.TRAIN, Role.TRAIN, Role.HOLDOUT))
    ]
    still = {"time_s": np.arange(1500) / 50.0, "depth_mm": np.full(1500, -5.0), "force_n": coloured(generator, 1500)}
    return [*found, Record(still, "noise", Role.NOISE)]


@pytest.fixture(scope="module")
def tied() -> Diagnosis:
    return diagnose(BASE, at_one_speed(VISCOUS), library=FEW)


@pytest.fixture(scope="module")
def planned(tied: Diagnosis) -> NextTrials:
    found = next_trials(tied, PROGRAMS)
    assert found is not None
    return found


@pytest.mark.slow
def test_a_repetition_of_a_motion_that_does_not_separate_the_hypotheses_gives_little(
    tied: Diagnosis, planned: NextTrials
) -> None:
    assert tied.decision.verdict is Verdict.AMBIGUOUS
    assert planned.bits > 5 * planned.repeated_bits


@pytest.mark.study
def test_the_best_motion_decides_what_a_repetition_leaves_open(planned: NextTrials) -> None:
    generator = np.random.default_rng(4)
    last = at_one_speed(VISCOUS)[2].motion()
    answers = [
        diagnose(
            BASE, [*at_one_speed(VISCOUS), trial_of(motion, generator, "next", Role.HOLDOUT, VISCOUS)], library=FEW
        ).decision
        for motion in (planned.motions[0].motion, last)
    ]
    assert (answers[0].verdict, answers[0].names) == (Verdict.NAMED, ("viscous",))
    assert answers[1].verdict is Verdict.AMBIGUOUS


@pytest.mark.slow
def test_candidates_are_the_programs_and_all_motions_so_far(planned: NextTrials) -> None:
    names = [name for name, _ in planned.considered]
    assert sorted(names) == sorted([
        *(each.name for each in PROGRAMS), *(f"trial {number}, again" for number in range(3))
    ])  # fmt: skip
    bits = [value for _, value in planned.considered]
    assert bits == sorted(bits, reverse=True)
    assert planned.bits == bits[0]
    assert dict(planned.considered)["trial 2, again"] == planned.repeated_bits


@pytest.mark.slow
def test_several_trials_at_once_give_more_than_one_and_than_repetitions(tied: Diagnosis, planned: NextTrials) -> None:
    three = next_trials(tied, PROGRAMS, 3)
    assert three is not None
    assert len(three.motions) == 3
    assert three.bits > max(planned.bits, three.repeated_bits)
    assert "3 trials of" in three.why
    assert all(name in three.why for name in ("viscous", "relaxation"))


def test_without_programs_a_repetition_is_what_remains(tied: Diagnosis) -> None:
    found = next_trials(tied, ())
    assert found is not None
    assert found.bits >= found.repeated_bits
    assert all(each.program is None for each in found.motions)


@pytest.mark.slow
def test_if_nothing_is_missing_a_motion_is_sought_that_would_show_hidden_effects() -> None:
    names = ("viscous", "drift", "thermal_drift", "gain_error", "friction_layer")
    library = Library([effect_named(name) for name in names], BASE)
    calm = diagnose(BASE, at_one_speed(0.0), library=library, settings=Settings(relevant=0.3, named=0.8))
    assert calm.posterior.probability((), "") > 0.8
    found = next_trials(calm, PROGRAMS)
    assert found is not None
    assert found.question == "whether an effect of 0.3 noise RMS is hidden, and which"
    assert 0 < found.repeated_bits <= found.bits <= found.open_bits


@pytest.mark.slow
def test_a_named_set_needs_no_motion(planned: NextTrials) -> None:
    more = trial_of(planned.motions[0].motion, np.random.default_rng(4), "next", Role.HOLDOUT, VISCOUS)
    named = diagnose(BASE, [*at_one_speed(VISCOUS), more], library=FEW)
    assert next_trials(named, PROGRAMS) is None


def random_columns(generator: np.random.Generator) -> tuple[Array, list[Array]]:
    noise = generator.standard_normal((30, 4))
    return noise, [generator.standard_normal((30, 1 + count)) / 3 for count in (2, 3, 1)]


def dense_bits(noise: Array, columns: Sequence[Array], probabilities: Array, functions: Sequence[int]) -> float:
    """Return the information from covariance matrices of the readings."""
    base = np.eye(30) + noise @ noise.T
    means = [each[:, 0] for each in columns]
    covariances = [base + each[:, 1:] @ each[:, 1:].T for each in columns]
    total = 0.0
    for i, own in enumerate(probabilities):
        mixed = 0.0
        for j, other in enumerate(probabilities):
            middle = (covariances[i] + covariances[j]) / 2
            shift = means[i] - means[j]
            whole, first, second = (np.linalg.slogdet(each)[1] for each in (middle, covariances[i], covariances[j]))
            distance = shift @ np.linalg.solve(middle, shift) / 8 + (whole - first / 2 - second / 2) / 2
            mixed += other * math.exp(-distance)
        total -= own * math.log(mixed)
    for own, known, covariance, each in zip(probabilities, functions, covariances, columns, strict=True):
        rest = base + each[:, 1 + known :] @ each[:, 1 + known :].T
        total += own * (np.linalg.slogdet(covariance)[1] - np.linalg.slogdet(rest)[1]) / 2
    return total / math.log(2)


@pytest.mark.parametrize("functions", [(0, 0, 0), (0, 2, 1)])
def test_information_is_that_of_dense_covariances(functions: tuple[int, ...]) -> None:
    noise, columns = random_columns(np.random.default_rng(1))
    probabilities = np.array([0.5, 0.3, 0.2])
    made = _Shared(noise, noise).prediction(columns, functions)
    assert made.bits(probabilities) == pytest.approx(dense_bits(noise, columns, probabilities, functions), rel=1e-9)


def test_columns_that_all_hypotheses_share_are_given_once() -> None:
    generator = np.random.default_rng(3)
    noise, columns = random_columns(generator)
    common, probabilities = generator.standard_normal((30, 5)), np.array([0.5, 0.3, 0.2])
    each = [np.hstack([own, common]) for own in columns]
    dense = dense_bits(noise, each, probabilities, (0, 2, 1))
    made = _Shared(noise, noise).prediction(columns, (0, 2, 1), common)
    assert made.bits(probabilities) == pytest.approx(dense, rel=1e-9)


def test_trials_add_up() -> None:
    generator = np.random.default_rng(2)
    probabilities = np.array([0.5, 0.3, 0.2])
    both = [random_columns(generator) for _ in range(2)]
    made = [_Shared(noise, noise).prediction(columns, (0, 0, 0)) for noise, columns in both]
    noise = np.block([[both[0][0], np.zeros((30, 4))], [np.zeros((30, 4)), both[1][0]]])
    stacked = [np.vstack(each) for each in zip(both[0][1], both[1][1], strict=True)]
    whole = _Shared(noise, noise).prediction(stacked, (0, 0, 0))
    assert (made[0] + made[1]).bits(probabilities) == pytest.approx(whole.bits(probabilities), rel=1e-9)
    assert made[0].times(2).bits(probabilities) == pytest.approx((made[0] + made[0]).bits(probabilities), rel=1e-12)


def test_information_on_what_is_true_lies_between_zero_and_the_entropy() -> None:
    probabilities = np.array([0.7, 0.3])
    alike = Prediction(np.zeros((2, 2)), (0, 1, 2), (0, 0))
    apart = Prediction(np.diag([1e6, 0.0]), (0, 1, 2), (0, 0))
    assert alike.bits(probabilities) == pytest.approx(0.0, abs=1e-12)
    assert apart.bits(probabilities) == pytest.approx(-probabilities @ np.log2(probabilities))
