import math
from itertools import product

import numpy as np
import pytest

from needleplan.estimation import JointForce, NumericJointSystem, SampleUse
from needleplan.identification import FilterStatus, Recipe, identify_by_passes, mean_absolute_error, replay
from needleplan.models import fit, simulate
from needleplan.models.force import ForceModel1, with_gauge
from needleplan.signals import Motion, insertion_cycles
from needleplan_thesis.chapter2.forces import PUBLISHED_FORCES
from tests.estimation.insertions import AVERAGE, JOINT, MODEL, as_record, moved, recorded
from tests.models.lag import Lag

CORNERS = list(product((-1, 1), repeat=5))


@pytest.mark.study
@pytest.mark.parametrize(("number", "corner", "factor"), [(0, 0, 6.0), (2, 31, 3.0)])
def test_starts_that_are_far_off_end_at_the_noise(number: int, corner: int, factor: float) -> None:
    chosen = PUBLISHED_FORCES[number]
    record = recorded(chosen.model, chosen.velocity_mm_s, seed=corner)
    joint = JointForce(chosen.model)
    factors = {name: factor**sign for name, sign in zip(joint.free, CORNERS[corner], strict=True)}
    run = identify_by_passes(joint, moved(chosen.model, factors), [record], smooth=AVERAGE)
    assert run.status is FilterStatus.DONE
    truth = record.with_column("force_n", AVERAGE.apply(simulate(chosen.model, record.motion()).output))
    assert mean_absolute_error(run.model, [truth], smooth=AVERAGE) < 10e-3
    assert run.innovation_rmse[-1] < 5e-3
    assert run.replay_mae[-1] < run.replay_mae[0] + 1e-3
    assert len(run.replay_mae) == len(Recipe().variances)


def test_tracks_hold_the_truth_within_three_sigma() -> None:
    start = moved(MODEL, {"sigma0": 1.3, "sigma1": 0.8, "sigma2": 1.2, "f1": 0.9, "beta": 1.1})
    clean = recorded(MODEL, noise_n=0.0)
    white = 2e-3 * np.random.default_rng(2).standard_normal(len(clean))
    record = clean.with_column("force_n", simulate(MODEL, clean.motion()).output + white)
    run = identify_by_passes(JOINT, start, [record], Recipe(variances=(4e-6,), spreads=(0.15,), walk=0.0))
    (track,) = run.tracks
    for name, (low, value, high) in track.values.items():
        assert ((low <= value) & (value <= high)).all()
        inside = (low <= getattr(MODEL, name)) & (getattr(MODEL, name) <= high)
        assert inside.mean() > 0.95, name
        assert np.log(high[-1] / low[-1]) < np.log(high[0] / low[0])
    assert track.state is not None
    assert len(track.time_s) == len(record)
    assert track.innovation_rmse() == pytest.approx(run.innovation_rmse[-1])


@pytest.mark.slow
def test_model_1_is_filtered_too() -> None:
    truth = with_gauge(ForceModel1(**MODEL.values()), 0.02)
    start = moved(truth, {"sigma0": 0.5, "sigma1": 2.0, "sigma2": 0.6, "f1": 1.5, "alpha": 0.7}).with_values(f2=0.01)
    record = recorded(truth)
    run = identify_by_passes(JointForce(truth), start, [record], smooth=AVERAGE)
    assert run.replay_mae[-1] < 5e-3
    assert run.model.values()["beta"] == 0.02


def test_any_model_can_be_filtered() -> None:
    truth = Lag(0.2, 0.4, -0.05)
    time = np.arange(400) / 40
    motion = Motion.sampled(time, 5 - 5 * np.cos(2 * time), 10 * np.sin(2 * time))
    noise = 0.02 * np.random.default_rng(0).standard_normal(len(motion))
    record = as_record(motion, simulate(truth, motion).output + noise)
    start = Lag(0.6, 0.15, 0.0)
    recipe = Recipe(variances=(4e-4,), spreads=(1.0,), factor=3.0, settle=0, reach=math.inf, limit=math.inf)
    run = identify_by_passes(NumericJointSystem(start), start, [record], recipe)
    found = run.model.values()
    batch = fit(start, record).model.values()
    for name in ("gain", "time_constant", "offset"):
        assert found[name] == pytest.approx(batch[name], rel=0.05, abs=0.005)
    assert run.counts[SampleUse.USED] == len(record)


@pytest.mark.slow
def test_records_one_after_the_other() -> None:
    records = [recorded(MODEL, depth=40.0), recorded(MODEL, depth=30.0, seed=1)]
    short = Recipe(variances=(1e-2, 1e-4), spreads=(0.67, 0.33))
    run = identify_by_passes(JOINT, moved(MODEL, {"sigma2": 2.0}), records, short, smooth=AVERAGE)
    assert len(run.tracks) == 2
    assert run.replay_mae[-1] < 3e-3
    first, second = run.tracks
    width = [np.log(each.values["sigma2"][2] / each.values["sigma2"][0]) for each in (first, second)]
    assert width[1][0] < width[0][0]  # the second goes on with what the first has learnt


@pytest.mark.slow
def test_a_lost_filter_says_so() -> None:
    record = recorded(MODEL, depth=20.0)
    force = record["force_n"].copy()
    force[200] = 1e300
    wild = record.with_column("force_n", force)
    run = identify_by_passes(JOINT, MODEL, [wild], Recipe(limit=math.inf, reach=math.inf), smooth=AVERAGE)
    assert run.status is FilterStatus.DIVERGED
    assert not run.ok
    assert run.model == MODEL
    safe = identify_by_passes(JOINT, MODEL, [wild])
    assert safe.ok
    assert mean_absolute_error(safe.model, [record], smooth=AVERAGE) < 5e-3


def test_replay_of_what_is_not_measured() -> None:
    record = recorded(MODEL, depth=10.0, noise_n=0.0)
    assert mean_absolute_error(MODEL, [record], smooth=AVERAGE) < 1e-12
    assert np.isnan(mean_absolute_error(MODEL, [record.with_column("force_n", np.full(len(record), np.nan))]))
    assert mean_absolute_error(MODEL.with_values(f1=0.002), [recorded(MODEL)]) == float("inf")
    assert replay(MODEL, record).shape == (len(record),)
    assert insertion_cycles(10.0, 10.0).time_s.size == len(record)


def test_a_start_at_the_bound_is_released() -> None:
    """At f1 = -f2, the output does not depend on the coordinate of f1, and the filter would stay there."""
    joint = JointForce(MODEL)
    clipped = MODEL.with_values(f1=-MODEL.f2 * (1 + 1e-6), sigma2=2 * MODEL.sigma2)
    released = joint.released(clipped, 6.0)
    assert released.values()["f1"] == pytest.approx(-MODEL.f2 * 6**0.5, rel=1e-3)
    assert joint.released(MODEL, 6.0) == MODEL
    record = recorded(MODEL).select(slice(0, None, 4))
    run = identify_by_passes(joint, clipped, [record])
    assert run.ok
    assert run.replay_mae[-1] < 0.01
