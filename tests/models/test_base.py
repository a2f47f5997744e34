import numpy as np
import pytest
from scipy.integrate import solve_ivp

from needleplan.errors import DataError, ModelError
from needleplan.models import KINDS, FitStatus, LumpedLuGre, Model, Profile, Scale, fit, simulate
from needleplan.signals import Array, Motion, Record
from tests.models.lag import Lag, SteppedLag


def swing(seconds: float = 10.0, rate_hz: float = 200.0) -> Motion:
    time = np.arange(round(seconds * rate_hz)) / rate_hz
    return Motion.sampled(time, 5 - 5 * np.cos(2 * time), 10 * np.sin(2 * time))


def reference(model: Lag | SteppedLag, motion: Motion) -> Array:
    """What a stiff solver says of the motion that is linear between samples."""
    solution = solve_ivp(
        lambda t, z: (model.gain * np.interp(t, motion.time_s, motion.velocity_mm_s) - z) / model.time_constant,
        (motion.time_s[0], motion.time_s[-1]), [0.0], "Radau", motion.time_s, rtol=1e-9, atol=1e-10, max_step=0.005,
    )  # fmt: skip
    return np.asarray(solution.y[0])


@pytest.mark.slow
@pytest.mark.parametrize(("time_constant", "error"), [(0.003, 2e-4), (0.1, 3e-5), (3.0, 3e-5)])
def test_a_linear_state_is_integrated_to_the_solution(time_constant: float, error: float) -> None:
    model = Lag(0.2, time_constant, 0.1)
    motion = swing(2.0)
    np.testing.assert_allclose(simulate(model, motion).output, reference(model, motion) + 0.1, atol=error)


@pytest.mark.slow
def test_kutta_is_of_third_order() -> None:
    model = SteppedLag(0.2, 0.02)
    motion = swing(2.0)
    exact = reference(model, motion)
    errors = [np.abs(simulate(model, motion, substeps=steps).output - exact).max() for steps in (1, 2, 4)]
    assert errors[0] / errors[1] > 6
    assert errors[2] < 1e-6


def test_a_state_goes_on_where_it_was() -> None:
    model, motion = Lag(0.2, 0.4), swing()
    whole = simulate(model, motion)
    rest = simulate(model, motion[700:], whole.states[:, 700])
    np.testing.assert_allclose(rest.output, whole.output[700:], rtol=1e-12)


def test_at_rest_the_last_direction_stays() -> None:
    motion = Motion.sampled(np.arange(7.0), np.zeros(7), np.array([0, 0, 2, 0, -1, 0, 0.0]))
    assert motion.direction.tolist() == [0, 0, 1, 1, -1, -1, -1]


def test_all_wrong_parameters_are_named() -> None:
    with pytest.raises(ModelError) as raised:
        Lag(float("nan"), -1.0)
    assert [each.key for each in raised.value.mistakes] == ["gain", "time_constant"]
    assert "must be from 0.001 to 1000 s" in str(raised.value)


@pytest.mark.parametrize("columns", [
    {"time_s": [0, 1, 1.0], "depth_mm": [0, 1, 2.0]},
    {"time_s": [0, 1, 2.0], "depth_mm": [0, np.nan, 2.0]},
    {"time_s": [0, 1, 2.0], "depth_mm": [0, 1.0]},
    {"time_s": [0.0], "depth_mm": [0.0]},
    {"time_s": [0, 1, 0.5], "depth_mm": [0, 1.0, 2.0]},
])  # fmt: skip
def test_samples_that_are_no_motion_are_refused(columns: dict[str, list[float]]) -> None:
    with pytest.raises(DataError):
        Record({name: np.array(values) for name, values in columns.items()}).motion()


def recorded(model: Lag, noise: float, seed: int, correlated: bool = False, seconds: float = 10.0) -> Record:
    motion = swing(seconds)
    drawn = np.random.default_rng(seed).standard_normal(len(motion) + 9)
    disturbance = np.convolve(drawn, np.full(10, 10**-0.5), "valid") if correlated else drawn[9:]
    return Record({
        "time_s": motion.time_s, "depth_mm": motion.depth_mm, "velocity_mm_s": motion.velocity_mm_s,
        "force_n": simulate(model, motion).output + noise * disturbance,
    })  # fmt: skip


def test_a_fit_finds_what_made_the_data() -> None:
    truth = Lag(0.2, 0.4, -0.05)
    found = fit(Lag(2.0, 0.1), recorded(truth, 0.0, 0))
    assert found.status is FitStatus.CONVERGED
    for name, estimate in found.estimates.items():
        assert estimate.value == pytest.approx(getattr(truth, name), rel=1e-5)
    assert found.rmse < 1e-6


@pytest.mark.study
@pytest.mark.parametrize("correlated", [False, True])
def test_intervals_hold_the_truth_as_often_as_they_say(correlated: bool) -> None:
    truth = Lag(0.2, 0.4, -0.05)
    held, count = np.zeros(3), 200 if correlated else 100
    for seed in range(count):
        found = fit(truth, recorded(truth, 0.2, seed, correlated, 5.0))
        held += [each.low <= getattr(truth, name) <= each.high for name, each in found.estimates.items()]
    assert (held / count > 0.88).all()
    assert (held / count < 1.0).all()


def test_what_the_data_cannot_tell_is_said() -> None:
    truth = Lag(0.2, 0.4)
    motion = Motion.sampled(np.arange(400) / 200, np.arange(400) / 20, np.full(400, 10.0))
    settled = Record({
        "time_s": motion.time_s, "depth_mm": motion.depth_mm, "velocity_mm_s": motion.velocity_mm_s,
        "force_n": np.full(400, 2.0) + 0.01 * np.sin(np.arange(400.0) ** 2),
    })  # fmt: skip
    found = fit(truth.with_values(time_constant=1e-3), settled, free=["gain", "offset"])
    assert not found.estimates["gain"].identified or found.condition > 100


def test_bounds_of_an_unknown_parameter_are_refused() -> None:
    record = recorded(Lag(0.2, 0.4, 0.1), 0.01, 1)
    with pytest.raises(ModelError, match="must be one of gain, time_constant") as raised:
        fit(Lag(1.0, 1.0), record, bounds={"gian": (0.0, 1.0), "gain": (0.0, 1.0)})
    assert [each.key for each in raised.value.mistakes] == ["gian"]


def test_a_fit_needs_a_model() -> None:
    with pytest.raises(ModelError, match="model = <int>: must be a model of needleplan"):
        fit(3, Record({"time_s": [0.0, 1.0], "depth_mm": [0.0, 1.0]}))  # type: ignore[arg-type]


def test_records_that_identify_nothing_are_refused() -> None:
    rest = Record({"time_s": np.arange(50.0), "depth_mm": np.ones(50), "force_n": np.ones(50)})
    time = np.arange(50.0)
    dead = Record({"time_s": time, "depth_mm": 10 * time, "force_n": np.full(50, 0.3)})
    with pytest.raises(DataError, match=r"force_n = 0\.3: is constant to the last bit"):
        fit(Lag(1.0, 1.0), dead)
    with pytest.raises(DataError, match="at rest"):
        fit(Lag(1.0, 1.0), rest)
    with pytest.raises(DataError, match="too short"):
        fit(Lag(1.0, 1.0), recorded(Lag(1.0, 1.0), 0.0, 0).select(slice(0, 8)))
    with pytest.raises(DataError, match="force_n"):
        fit(Lag(1.0, 1.0), Record({"time_s": np.arange(50.0), "depth_mm": np.arange(50.0)}))
    with pytest.raises(ModelError, match="must be one of"):
        fit(Lag(1.0, 1.0), recorded(Lag(1.0, 1.0), 0.0, 0), free=["gian"])


def test_masked_samples_are_counted_not_dropped_silently() -> None:
    record = recorded(Lag(0.2, 0.4), 0.0, 0)
    force = record["force_n"].copy()
    force[100:110] = np.nan
    found = fit(Lag(0.2, 0.4), record.with_column("force_n", force), mask=lambda each: each["time_s"] > 0.1)
    assert found.masked == 10 + 21
    assert found.samples + found.masked == len(record)
    assert np.isnan(found.residuals[0]).sum() == found.masked


@pytest.mark.parametrize("kind", KINDS.values(), ids=KINDS)
def test_a_member_documents_every_parameter_with_its_unit(kind: type[Model]) -> None:
    lines = (kind.__doc__ or "").splitlines()
    for name, what in kind.parameters().items():
        (row,) = (index for index, line in enumerate(lines) if line.startswith(f"{name} : float"))
        assert lines[row + 1] == f"    {what.about}{', ' if what.unit else ''}{what.unit}"


@pytest.mark.parametrize("kind", KINDS.values(), ids=KINDS.keys())
def test_no_scale_comes_from_the_range(kind: type[Model]) -> None:
    """A scale that is as wide as the range would make every standard deviation look small."""
    for name, what in kind.parameters().items():
        if what.scale is Scale.LINEAR:
            widest = max(abs(what.lower), abs(what.upper))
            assert what.typical < widest / 2 or widest <= 1, name  # a share may be 1


def test_a_constant_that_is_fitted_after_all_is_judged_by_its_typical_size() -> None:
    """The ramp of 2.5 mm is known to some 10 mm: not at all. Its range of 1,000 mm hid that."""
    model = LumpedLuGre(mu_c=0.4, sigma2=0.01, sigma0=1.0, sigma1=0.2, mu_s=0.05, alpha=0.08, profile=Profile.ISOSCELES)
    time = np.linspace(0, 4, 400)
    motion = Motion.sampled(time, 30 + 5 * time)
    noise = np.random.default_rng(0).normal(0, 0.3, 400)
    columns = {"time_s": time, "depth_mm": motion.depth_mm, "force_n": simulate(model, motion).output + noise}
    ramp = fit(model, Record(columns), free=["mu_c", "ramp_mm"]).estimates["ramp_mm"]
    assert 2.5 < ramp.sd < 100
    assert not ramp.identified
