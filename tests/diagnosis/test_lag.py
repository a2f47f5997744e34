"""Fast computations against their slow reference."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from needleplan.diagnosis import Library, catalogue
from needleplan.diagnosis.channels import at_depth
from needleplan.models import simulate
from needleplan.models.effects import Effect, Reach, effect_named
from needleplan.signals import SensorNoise, lag_taps, lagged
from tests.diagnosis.tip_trials import BASE as TIP
from tests.diagnosis.tip_trials import motion as tip_motion
from tests.diagnosis.trials import BASE, motion


@pytest.mark.parametrize("lag_s", [-0.001, 0.0, 0.005, 0.012, 0.06, 0.19])
def test_what_is_read_late_is_whitened_as_if_it_were_read_first(lag_s: float) -> None:
    path = motion(0)
    noise = SensorNoise(np.array([0.4, 0.1]), 0.02, 0.03)
    taps = lag_taps(path, lag_s)
    assert taps is not None
    values = simulate(BASE, path).output[:, None] * np.array([1.0, 2.0])
    apart = noise.whiten(lagged(values, path, lag_s))
    # A short memory is cut off, in either way, after a part in a thousand of the lag.
    within = 1e-9 if lag_s > 0.007 or lag_s <= 0 else 0.02
    np.testing.assert_allclose(noise.whiten(values, taps), apart, atol=within * np.abs(apart).max())


def test_uneven_samples_have_no_taps() -> None:
    path = motion(1)
    assert lag_taps(path[np.flatnonzero(np.arange(len(path)) % 7)], 0.004) is None


def test_a_late_reading_is_the_mean_of_the_force_over_how_late_it_is() -> None:
    """256 lags in a row are late by a sum of 256 waiting times; the force is straight between samples."""
    path = motion(0)[:600]
    force = simulate(BASE, path).output
    waits = stats.gamma(256, scale=0.03 / 256).ppf((np.arange(4000) + 0.5) / 4000)
    wanted = np.mean([np.interp(path.time_s - wait, path.time_s, force) for wait in waits], axis=0)
    late_model = effect_named("latency").apply(BASE, {"size": 0.03})
    found = simulate(late_model, path)
    assert np.ptp(path.interval_s) < 1e-9
    np.testing.assert_allclose(found.output, wanted, atol=2e-5)
    delayed = np.interp(path.time_s - 0.03, path.time_s, force)
    assert np.abs(found.output - delayed).max() < 0.12 * np.abs(force - delayed).max()


def test_a_late_reading_of_uneven_samples_is_nearly_that_of_even_ones() -> None:
    path = motion(0)[:600]
    jitter = 0.004 * np.sin(np.arange(600) * 1.7)
    jitter[[0, -1]] = 0.0
    times = path.time_s + jitter
    uneven = replace(
        path, time_s=times, depth_mm=np.interp(times, path.time_s, path.depth_mm),
        velocity_mm_s=np.interp(times, path.time_s, path.velocity_mm_s),
        angle_rad=np.interp(times, path.time_s, path.angle_rad),
    )  # fmt: skip
    late_model = effect_named("latency").apply(BASE, {"size": 0.03})
    even, found = simulate(late_model, path).output, simulate(late_model, uneven).output
    wrong = np.abs(found - np.interp(times, path.time_s, even))
    assert wrong.mean() < 0.01 * np.abs(even - simulate(BASE, path).output).max()


def test_wear_is_that_of_all_cells() -> None:
    path, sliding = motion(1), 40.0
    edges = 2.0 * np.arange(75)[:, None]
    filled = np.clip((path.depth_mm - edges) / 2.0, 0.0, 1.0)
    rounds = np.abs(np.diff(path.depth_mm)) * (filled[:, 1:] + filled[:, :-1]) / 2
    slid = np.concatenate([np.zeros((75, 1)), np.cumsum(rounds, axis=1)], axis=1)
    bristle = simulate(BASE, path).states[0]
    wanted = -0.003 * (-np.expm1(-slid / sliding) * filled * 2.0).sum(axis=0) * bristle
    whole = simulate(effect_named("path_damage").apply(BASE, {"size": 0.25, "sliding_mm": sliding}), path)
    np.testing.assert_allclose(whole.output - simulate(BASE, path).output, wanted, atol=1e-12)


def test_functions_of_depth_are_interpolated() -> None:
    places = np.arange(0.0, 30.5, 0.5)
    rows = np.random.default_rng(0).standard_normal((len(places), 5))
    depth = np.append(np.random.default_rng(1).uniform(0, 30, 200), [0.0, 30.0])
    wanted = np.column_stack([np.interp(depth, places, row) for row in rows.T])
    np.testing.assert_allclose(at_depth(depth, places, rows), wanted, atol=1e-12)


def test_sensitivities_are_cached_by_the_whole_motion() -> None:
    path = tip_motion(0)
    turned = replace(path, angle_rad=path.angle_rad + 1.0)
    library = Library([effect_named("pre_bend"), effect_named("coil_offset")], TIP)
    entries = library.entries([path, turned])
    for each in (path, turned, path):
        wanted = np.column_stack([one.effect.columns(TIP, each, one.grid) for one in entries])
        np.testing.assert_array_equal(library.sensitivities(TIP, each, entries), wanted)
    part = library.sensitivities(TIP, path, entries[1:])
    np.testing.assert_array_equal(part, library.sensitivities(TIP, path, entries)[:, entries[1].first :])


def test_many_breaths_are_those_of_one_after_the_other() -> None:
    effect = effect_named("respiration")
    for path in (motion(0), motion(2)):
        grid = effect.grid(Reach.of([path]))[::7]
        np.testing.assert_allclose(
            effect.columns(BASE, path, grid), Effect.columns(effect, BASE, path, grid), rtol=1e-9, atol=1e-9
        )
    # Beside an effect that is there already, and for a breath that says no more than its size, it is one by one.
    beside = effect_named("bristle").apply(BASE, {"size": 0.3})
    np.testing.assert_array_equal(
        effect.columns(beside, path, grid[:2]), Effect.columns(effect, beside, path, grid[:2])
    )


def test_a_library_forgets_the_motions_that_were_used_longest_ago(monkeypatch: pytest.MonkeyPatch) -> None:
    library = Library([effect_named("bias"), effect_named("viscous")], BASE)
    motions = [motion(number) for number in range(3)]
    entries = library.entries(motions)
    first = library.sensitivities(BASE, motions[0], entries)
    monkeypatch.setattr(catalogue, "KEPT_BYTES", 1.5 * first.nbytes)
    monkeypatch.setattr(catalogue, "KEPT_MOTIONS", 1)
    assert library.sensitivities(BASE, motions[0], entries) is first
    for other in motions[1:]:
        library.sensitivities(BASE, other, entries)
    again = library.sensitivities(BASE, motions[0], entries)
    assert again is not first
    np.testing.assert_array_equal(again, first)
