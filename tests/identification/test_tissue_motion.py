import numpy as np
import pytest
from matplotlib.figure import Figure

from needleplan.errors import DataError
from needleplan.identification import Identification
from needleplan.identification.tissue_motion import identify
from needleplan.models import LumpedOnTissue, simulate
from needleplan.models.tissue import fit_on_tissue, lag_with_sd, tissue_lag_rad, tissue_start
from needleplan.signals import HighGainObserver, MovingAverage, Record, Role, sinusoid

TRUTH = LumpedOnTissue(
    sigma0=1.203, sigma1=0.374, sigma2=0.014, mu_c=0.788, mu_s=0.033, alpha=0.088, stiffness=0.13, damping=0.02
)
DRY = LumpedOnTissue(
    sigma0=1.2, sigma1=0.05, sigma2=0.003, mu_c=0.35, mu_s=0.3, alpha=0.3, stiffness=0.13, damping=0.02
)


def recorded(model: LumpedOnTissue, amplitude_mm: float = 40.0, role: Role = Role.TRAIN, seed: int = 0) -> Record:
    """A swing at 50 Hz as the robot would record it: late velocity, averaged force, encoder steps, a marker."""
    motion = sinusoid(offset_mm=126, amplitude_mm=amplitude_mm, frequency_hz=0.1, cycles=2.5, rate_hz=50)
    done = simulate(model, motion)
    generator = np.random.default_rng(seed)
    noisy = done.output + generator.normal(0, 0.01, len(motion))
    depth = np.round(motion.depth_mm, 3)
    return Record({
        "time_s": motion.time_s, "depth_mm": depth, "force_n": MovingAverage(5).apply(noisy),
        "velocity_mm_s": HighGainObserver.critically_damped(40, 0.02).observe(depth),
        "x_mm": done.states[1] + generator.normal(0, 0.05, len(motion)),
    }, trial=f"{amplitude_mm:g} mm", role=role)  # fmt: skip


@pytest.fixture(scope="module")
def identified() -> Identification:
    records = [recorded(TRUTH), recorded(TRUTH, 12.0, seed=1), recorded(TRUTH, 25.0, Role.HOLDOUT, seed=2)]
    return identify(records, marker="x_mm", starts=1)


def true_lag_deg(model: LumpedOnTissue) -> float:
    motion = sinusoid(offset_mm=126, amplitude_mm=40, frequency_hz=0.1, cycles=2.5, rate_hz=50)
    record = Record({"time_s": motion.time_s, "depth_mm": motion.depth_mm, "velocity_mm_s": motion.velocity_mm_s})
    return float(np.degrees(tissue_lag_rad(model, record, 0.1)))


@pytest.mark.study
def test_stiffness_and_damping_are_found_with_the_friction(identified: Identification) -> None:
    assert identified.ok
    for name in ("stiffness", "damping"):
        estimate = identified.estimates[name]
        assert estimate.identified
        assert estimate.value == pytest.approx(getattr(TRUTH, name), abs=4 * estimate.sd)
        assert estimate.sd < 0.15 * estimate.value  # it holds the scatter between the trials


@pytest.mark.slow
def test_lag_held_out_trial_remarks_and_figure(identified: Identification) -> None:
    scores = {name: value for name, value, _ in identified.scores}
    lag = true_lag_deg(TRUTH)
    assert scores["lag, fitted tissue"] == pytest.approx(lag, abs=1.0)
    assert scores["lag, slow observer"] == pytest.approx(lag, abs=2.5)
    assert scores["lag, marker x_mm"] == pytest.approx(lag, abs=1.0)
    assert scores["amplitude of the motion"] == pytest.approx(40, rel=1e-3)
    assert scores["RMSE on 25 mm"] < 1.3 * scores["RMSE, friction on tissue"]
    assert scores["RMSE, friction on tissue"] < 0.8 * scores["RMSE, friction on rigid tissue"]
    assert sum("later than the depth says" in each for each in identified.remarks) == 3
    assert not any("one amplitude" in each for each in identified.remarks)
    figure = Figure()
    identified.draw(figure)
    assert len(figure.axes) == 3


@pytest.mark.slow
def test_dry_friction_misleads_the_observer_and_that_is_said() -> None:
    found = identify([recorded(DRY)], starts=1)
    lag = true_lag_deg(DRY)
    scores = {name: value for name, value, _ in found.scores}
    assert scores["lag, slow observer"] > lag + 5
    assert scores["lag, fitted tissue"] == pytest.approx(lag, abs=1.0)
    (agreement,) = [each for each in found.findings if "slow observer" in each.name]
    assert agreement.p_value is not None
    assert agreement.p_value < 1e-3
    assert "disagree" in agreement.says
    assert any("second amplitude" in each for each in found.remarks)


def test_one_zero_each_way_is_no_test() -> None:
    found = identify([recorded(DRY).select(slice(0, 900))], starts=1)
    (agreement,) = [each for each in found.findings if "slow observer" in each.name]
    assert agreement.p_value is None
    assert "cannot be tested" in agreement.says


@pytest.mark.study
def test_the_deviation_of_the_lag_is_that_of_repeated_fits() -> None:
    records = [recorded(TRUTH, seed=seed) for seed in range(8)]
    motion = sinusoid(offset_mm=126, amplitude_mm=40, frequency_hz=0.1, cycles=2.5, rate_hz=50)
    exact = [each.with_column("velocity_mm_s", motion.velocity_mm_s) for each in records]
    lags = [lag_with_sd(fit_on_tissue([each], start=TRUTH, free=["stiffness", "damping"]), each, 0.1) for each in exact]
    scatter = float(np.std([lag for lag, _ in lags], ddof=1))
    said = float(np.mean([sd for _, sd in lags]))
    assert 0.3 < scatter / said < 3


def test_bad_records_are_refused() -> None:
    record = recorded(TRUTH)
    still = record.with_column("depth_mm", np.full(len(record), 7.0))
    with pytest.raises(DataError, match="at rest"):
        identify([still])
    with pytest.raises(DataError, match="no trial to identify"):
        identify([recorded(TRUTH, role=Role.HOLDOUT)])
    holes = record["force_n"].copy()
    holes[50] = np.nan
    with pytest.raises(DataError, match="finite"):
        identify([record.with_column("force_n", holes)])
    with pytest.raises(DataError, match="no friction"):
        tissue_start(record.with_column("force_n", np.zeros(len(record))))
