import numpy as np
import pytest

from needleplan.identification import FilterStatus, mean_absolute_error
from needleplan.models.force import ForceModel1, ForceModel2
from needleplan_thesis.chapter2.bank import TABLE_2_1, BankSettings, Exponents, Trigger, run_bank
from tests.estimation.insertions import AVERAGE, MODEL, moved, recorded

RECORD = recorded(MODEL, depth=40.0)
ONE = ForceModel1(**MODEL.values())
START = moved(MODEL, {"sigma0": 2.0, "sigma1": 0.5, "sigma2": 2.0, "f1": 2.0, "beta": 0.5})


@pytest.mark.parametrize("kind", [ForceModel1, ForceModel2])
def test_the_filters_share_out_what_is_free(kind: type[ForceModel1]) -> None:
    names = [name for each in TABLE_2_1[kind] for name in each]
    assert sorted(names) == sorted(name for name, what in kind.parameters().items() if what.free)
    assert len(TABLE_2_1[kind]) == 3


def test_the_bank_follows_the_force() -> None:
    run = run_bank(START, RECORD)
    assert run.status is FilterStatus.DONE
    assert run.track.innovation_rmse(np.arange(len(RECORD)) >= 5) < 0.05
    assert run.values["f2"] == MODEL.f2
    low, value, high = run.track.values["sigma2"]
    assert ((low <= value) & (value <= high)).all()
    assert value[-1] == run.values["sigma2"]


def test_small_innovations_do_not_make_a_model() -> None:
    run = run_bank(START, RECORD)
    replayed = mean_absolute_error(MODEL.with_values(**{
        name: float(np.clip(run.values[name], what.lower, what.upper)) for name, what in MODEL.parameters().items()
    }), [RECORD], smooth=AVERAGE)  # fmt: skip
    assert replayed > 2 * run.track.innovation_rmse(np.arange(len(RECORD)) > 1000)


def test_started_at_the_truth_without_walk_it_stays() -> None:
    quiet = BankSettings(filters=({"sigma0": 90}, {"f1": 90}, {"beta": 90}), initial_variance=1e-12)
    run = run_bank(MODEL, recorded(MODEL, depth=40.0, noise_n=0.0), quiet)
    assert run.values == pytest.approx(MODEL.values(), rel=1e-3)
    assert run.track.innovation_rmse() < 20e-3  # the reversal, where the sensor's average mixes both directions


def test_triggers_differ_in_what_they_update() -> None:
    short = RECORD.select(slice(0, 2))
    turn = run_bank(START, short, BankSettings(trigger=Trigger.ONE_IN_TURN)).values
    every = run_bank(START, short).values
    assert turn["beta"] == START.beta
    assert every["beta"] != START.beta


@pytest.mark.slow
def test_exponents_as_printed_make_bands_that_nobody_could_draw() -> None:
    wide, sane = (
        run_bank(ONE, RECORD, BankSettings(exponents=each, initial_variance=1.0)).track.values["sigma1"]
        for each in (Exponents.AS_PRINTED, Exponents.NEGATIVE)
    )
    assert (wide[2] - wide[0])[-1] > 1e6 * MODEL.sigma1
    assert (sane[2] - sane[0])[-1] < 10 * MODEL.sigma1
