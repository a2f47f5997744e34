import numpy as np
import pytest

from needleplan.errors import DataError
from needleplan.models import simulate
from needleplan.models.tissue import LumpedOnTissue, TuningStatus, tune_slow_observer
from needleplan.signals import Array, HighGainObserver, MovingAverage, Projection, lag_rad, sinusoid

VISCOUS = {"sigma0": 0.2, "sigma1": 0.02, "sigma2": 0.03, "mu_c": 0.05, "mu_s": 0.01, "alpha": 0.05}
MIXED = {"sigma0": 1.203, "sigma1": 0.374, "sigma2": 0.014, "mu_c": 0.788, "mu_s": 0.033, "alpha": 0.088}


def trial(friction: dict[str, float], stiffness: float, damping: float) -> tuple[Array, Array, Array, float]:
    """Time, depth, force as measured, and the lag of the relative velocity in degrees."""
    motion = sinusoid(offset_mm=126, amplitude_mm=40, frequency_hz=0.1, cycles=4)
    done = simulate(LumpedOnTissue(**friction, stiffness=stiffness, damping=damping), motion)
    noise = np.random.default_rng(1).normal(0, 0.009, len(motion))
    settled = slice(2000, None)
    relative = motion.velocity_mm_s - done.states[2]
    late = lag_rad(0.1, motion.time_s[settled], relative[settled], motion.velocity_mm_s[settled])
    return motion.time_s, motion.depth_mm, MovingAverage().apply(done.output + noise), float(np.degrees(late))


@pytest.mark.parametrize(("friction", "stiffness", "damping", "within"), [
    (VISCOUS, 0.1, 0.02, 1.5), (MIXED, 0.1, 0.02, 3.0),
])  # fmt: skip
def test_the_gap_finds_the_lag_of_the_tissue(
    friction: dict[str, float], stiffness: float, damping: float, within: float
) -> None:
    time, depth, force, lag = trial(friction, stiffness, damping)
    tuned = tune_slow_observer(time, depth, force)
    assert tuned.status is TuningStatus.COMPENSATED
    assert tuned.projection is not None
    assert np.degrees(tuned.projection.lag_rad(0.1)) == pytest.approx(lag, abs=within)
    assert min(tuned.upward, tuned.downward) >= 3


def test_at_the_root_the_loop_is_centred() -> None:
    time, depth, force, _ = trial(MIXED, 0.1, 0.02)
    tuned = tune_slow_observer(time, depth, force)
    assert tuned.projection is not None
    velocity = tuned.projection.slow.observe(depth)
    late = tuned.projection.fast.normalised.apply(force)
    rises = np.flatnonzero((late[:-1] < 0) & (late[1:] >= 0) & (time[:-1] > 1))
    falls = np.flatnonzero((late[:-1] >= 0) & (late[1:] < 0) & (time[:-1] > 1))
    assert np.median(velocity[rises]) == pytest.approx(np.median(velocity[falls]), abs=0.1)
    rigid = Projection.critically_damped(39.0, 0.005).transfer.apply(tuned.projection.fast.observe(depth))
    assert np.median(rigid[rises]) - np.median(rigid[falls]) > 5


def test_the_exact_observer_is_found_where_the_tissue_is_one() -> None:
    """A force that is proportional to the velocity of a slow observer is centred by that observer."""
    motion = sinusoid(offset_mm=126, amplitude_mm=40, frequency_hz=0.1, cycles=4)
    late = HighGainObserver.critically_damped(12.0, 0.005)
    fast = HighGainObserver.critically_damped(40.0, 0.005)
    force = 0.02 * Projection(fast, late).transfer.apply(motion.velocity_mm_s)
    tuned = tune_slow_observer(motion.time_s, motion.depth_mm, force)
    assert tuned.alpha1 == pytest.approx(12.0, abs=0.1)


def test_it_says_when_nothing_closes_the_loop() -> None:
    time, depth, force, _ = trial(MIXED, 5.0, 0.02)
    stiff = tune_slow_observer(time, depth, force)
    assert stiff.status is TuningStatus.NO_COMPENSATION
    assert stiff.alpha1 is None
    assert (stiff.gaps_mm_s < 0).all()
    pushed = tune_slow_observer(time, depth, np.abs(force) + 0.1)
    assert pushed.status is TuningStatus.TOO_FEW_CROSSINGS


def test_bad_records_are_refused() -> None:
    time = np.arange(100) / 200
    with pytest.raises(DataError, match="resample"):
        tune_slow_observer(np.delete(time, 50), np.ones(99), np.ones(99))
    with pytest.raises(DataError, match="finite"):
        tune_slow_observer(time, np.ones(100), np.full(100, np.nan))
    with pytest.raises(DataError, match="as long as"):
        tune_slow_observer(time, np.ones(99), np.ones(100))
