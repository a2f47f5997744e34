"""The further effects of the axial force beside computations of their own."""

import numpy as np
import pytest

from needleplan.models import Channel, ShaftAndTip, simulate
from needleplan.models.effects import (
    FURTHER_FORCE_EFFECTS,
    SIZE,
    AddedEffect,
    effect_named,
    effects_of,
    known_effects,
    with_effect,
)
from needleplan.signals import Array, Motion, lspb

BASE = ShaftAndTip(friction=0.012, cutting=0.4, onset_mm=4.0, presliding_mm=0.2)
PATH = lspb([-2, 30, 12, 50, -2], [8, 5, 6, 10], dwells_s=[0, 1, 0, 1], rate_hz=50)


def force(name: str, values: dict[str, float], motion: Motion = PATH) -> Array:
    return simulate(effect_named(name).apply(BASE, values), motion).output


def fine(motion: Motion, factor: int = 40) -> tuple[Array, Array]:
    """Times and depths of a motion whose velocity is linear between samples."""
    time = np.interp(np.arange((len(motion) - 1) * factor + 1) / factor, np.arange(len(motion)), motion.time_s)
    velocity = np.interp(time, motion.time_s, motion.velocity_mm_s)
    way = np.cumsum((velocity[1:] + velocity[:-1]) / 2 * np.diff(time))
    return time, motion.depth_mm[0] + np.concatenate([[0.0], way])


def bristle(needle_mm: Array, presliding_mm: float) -> Array:
    """Dahl's bristle of a needle, step by step."""
    z = np.zeros(len(needle_mm))
    for k, step in enumerate(np.diff(needle_mm)):
        z[k + 1] = np.sign(step) + (z[k] - np.sign(step)) * np.exp(-abs(step) / presliding_mm) if step else z[k]
    return z


def of_needle(needle_mm: Array, z: Array) -> Array:
    inside = np.maximum(needle_mm, 0)
    return BASE.friction * inside * z - BASE.cutting * np.expm1(-inside / BASE.onset_mm) * (1 + z) / 2


@pytest.mark.parametrize("size", [0.05, 0.4, 2.0])
def test_the_needle_crosses_the_play_before_it_turns(size: float) -> None:
    """Beside a needle that the walls of a gap push and pull, with 40 steps a sample."""
    _, motor = fine(PATH)
    needle = motor.copy()
    for k in range(1, len(motor)):
        needle[k] = min(max(needle[k - 1], motor[k]), motor[k] + size)
    expected = of_needle(needle, bristle(needle, BASE.presliding_mm))[::40]
    np.testing.assert_allclose(force("backlash", {SIZE: size}), expected, atol=0.01)
    assert np.abs(expected - simulate(BASE, PATH).output).max() > 0.1


def test_the_amplitude_of_a_play_acts_smoothly() -> None:
    """A fit needs this: 2 um more play change no sample by more than a fortieth of the force.

    Without the moment at which the gap is crossed, samples would jump by a tenth.
    """
    found = np.array([force("backlash", {SIZE: size}) for size in np.linspace(0.2, 0.3, 51)])
    assert np.abs(np.diff(found, axis=0)).max() < 0.02


@pytest.mark.parametrize("size", [0.05, 0.3])
def test_a_drive_that_sticks_falls_behind_and_catches_up(size: float) -> None:
    time, motor = fine(PATH)
    velocity = np.gradient(motor, time)
    travel, behind = 0.0, np.zeros(len(motor))
    for k in range(1, len(motor)):
        turned = velocity[k] * velocity[k - 1] < 0
        travel = 0.0 if turned or abs(velocity[k]) < 1e-2 else travel + abs(motor[k] - motor[k - 1])
        behind[k] = np.sign(velocity[k]) * travel * np.exp(-travel / (np.e * size))
    assert behind.max() == pytest.approx(size, rel=0.02)
    needle = motor - behind
    expected = of_needle(needle, bristle(needle, BASE.presliding_mm))[::40]
    left = np.abs(force("drive_stick", {SIZE: size}) - expected)
    gap = np.abs(expected - simulate(BASE, PATH).output).max()
    assert np.quantile(left, 0.98) < 0.1 * gap
    assert left.mean() < 0.02 * gap


def test_breath_moves_the_needle_and_not_the_motor() -> None:
    """In either order of addition, the play is outside of the breath."""
    play, breath = AddedEffect("backlash", {SIZE: 0.5}), AddedEffect(
        "respiration", {SIZE: 3.0, "frequency_hz": 0.25, "phase_rad": 1.0, "rest": 1.0}
    )  # fmt: skip
    one, other = (simulate(with_effect(BASE, pair), PATH).output for pair in ([play, breath], [breath, play]))
    np.testing.assert_array_equal(one, other)


def test_friction_of_the_guide_acts_outside_of_the_tissue() -> None:
    gained = force("guide_friction", {SIZE: 0.3}) - simulate(BASE, PATH).output
    _, motor = fine(PATH)
    np.testing.assert_allclose(gained, 0.3 * bristle(motor, 0.2)[::40], atol=2e-3)
    early = (PATH.depth_mm < 0) & (PATH.depth_mm > -1) & (PATH.time_s < 2)
    assert gained[early].min() > 0.25


def test_friction_differs_in_retraction() -> None:
    gained = force("friction_by_direction", {SIZE: 0.5}) - simulate(BASE, PATH).output
    _, motor = fine(PATH)
    z = bristle(motor, 0.2)[::40]
    np.testing.assert_allclose(gained, np.where(z < 0, 0.5 * 0.012 * np.maximum(PATH.depth_mm, 0) * z, 0), atol=2e-3)


def test_a_spring_at_the_entry_does_not_ask_for_the_direction() -> None:
    gained = force("entry_spring", {SIZE: 0.01, "depth_mm": 20.0}) - simulate(BASE, PATH).output
    np.testing.assert_allclose(gained, [0.01 * min(max(depth, 0), 20) for depth in PATH.depth_mm], atol=1e-12)


def test_a_track_ages_with_each_insertion_and_not_with_the_way() -> None:
    """Passes counted in cells of 0.1 mm, beside those of 2 mm."""
    gained = force("track_ageing", {SIZE: 0.5, "insertions": 1.0}) - simulate(BASE, PATH).output
    edges = np.arange(0, 60, 0.1)
    passes = np.zeros(len(edges))
    _, motor = fine(PATH, 20)
    z = bristle(motor, 0.2)
    expected = np.zeros(len(motor))
    for k in range(1, len(motor)):
        passes += (motor[k - 1] <= edges) & (motor[k] > edges)
        earlier = np.maximum(passes - 1, 0)
        expected[k] = -0.5 * 0.012 * z[k] * 0.1 * ((1 - np.exp(-earlier)) * (edges < motor[k])).sum()
    expected = expected[::20]
    np.testing.assert_allclose(gained, expected, atol=0.03 * np.abs(expected).max())
    first = PATH.time_s < PATH.time_s[np.argmax(PATH.depth_mm > 29)]
    assert not gained[first].any()
    assert np.abs(expected).max() > 0.02


def test_a_breath_of_a_phase_of_its_own_is_a_breath() -> None:
    values = {SIZE: 3.0, "frequency_hz": 0.25, "phase_rad": 1.0, "rest": 1.0}
    np.testing.assert_array_equal(force("respiration_by_trial", values), force("respiration", values))
    assert effect_named("respiration_by_trial").by_trial == ("phase_rad",)


def test_the_default_library_leaves_them_out() -> None:
    names = {each.name for each in FURTHER_FORCE_EFFECTS}
    assert len(names) == 7
    assert not names & {each.name for each in effects_of(Channel.FORCE)}
    assert names <= {each.name for each in effects_of(Channel.FORCE, further=True)}
    assert names <= known_effects().keys()


def test_a_delay_of_the_sensor_delays_all_effects_in_any_order() -> None:
    size_s = 0.06
    added = (AddedEffect("latency", {SIZE: size_s}), AddedEffect("viscous", {SIZE: 0.002}))
    undelayed = simulate(with_effect(BASE, added[1]), PATH).output
    late = np.interp(PATH.time_s - size_s, PATH.time_s, undelayed)
    for effects in (added, added[::-1]):
        found = simulate(with_effect(with_effect(BASE, effects[0]), effects[1]), PATH).output
        assert float(np.abs(found - undelayed).max()) > 0.1
        np.testing.assert_allclose(found, late, atol=0.02)
