"""The draft of an effect: its words, its table or wave, and the axis of the gap agree."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from needleplan.diagnosis import Curve, Curves, GapAxis
from needleplan.models.effects import Effect, known_effects, register_file
from needleplan.reports.diagnosis import effect_file_text
from needleplan.signals import Array
from tests.diagnosis.trials import BASE, motion

PERIOD_MM, PHASE, AMPLITUDE_N = 7.0, 0.6, 0.035


def curves(
    axis: GapAxis, low: float, high: float, ways: dict[str, Callable[[Array], Array]], count: int = 75
) -> Curves:
    places = np.linspace(low, high, count)
    every = np.ones(count, bool)
    return Curves(
        axis, "mm", tuple(Curve(way, places, of(places), np.full(count, 0.005), every) for way, of in ways.items()), 1.0
    )


def wave(places: Array) -> Array:
    return np.asarray(AMPLITUDE_N * np.sin(2 * np.pi * places / PERIOD_MM + PHASE))


@contextmanager
def registered(text: str, folder: Path) -> Iterator[Effect]:
    (folder / "draft.py").write_text(text)
    effect = register_file(str(folder / "draft.py"))
    try:
        yield effect
    finally:
        del known_effects()[effect.name]


def added(effect: Effect) -> Array:
    """Return the force that the effect adds along a motion, at the amplitude of the gap."""
    return np.asarray(effect.columns(BASE, motion(1), [{}])[:, 0] * effect.parameters["size"].typical)


def test_a_wave_of_the_position_is_drafted_as_one(tmp_path: Path) -> None:
    """Errors of the base model beside the wave, different on the way in and out, are not part of the draft."""
    ways = {
        "advance": lambda x: wave(x) + 0.13 + 0.03 * np.exp(-x / 20),
        "retraction": lambda x: wave(x) + 0.1 + 0.001 * x,
    }
    text = effect_file_text(curves(GapAxis.PERIOD, -10, 70, ways), "ripple")
    assert "The gap is a wave of the position with a period of 7" in text
    assert "depends on depth" not in text
    assert "along the position" in text
    with registered(text, tmp_path) as effect:
        np.testing.assert_allclose(added(effect), wave(motion(1).depth_mm), atol=0.1 * AMPLITUDE_N)


def test_a_gap_along_the_position_without_a_wave_is_a_table(tmp_path: Path) -> None:
    bump = {"advance": lambda x: np.exp(-(((x - 30) / 8) ** 2)), "retraction": lambda x: 0 * x}
    text = effect_file_text(curves(GapAxis.PERIOD, 0, 60, bump), "bump_of_position")
    assert "The gap depends on the position. The table below" in text
    with registered(text, tmp_path) as effect:
        assert np.ptp(added(effect)) > 0.5


def test_a_gap_along_the_time_at_rest_is_a_table_of_this_time(tmp_path: Path) -> None:
    text = effect_file_text(curves(GapAxis.DWELL, 0, 3, {"rest": lambda x: 0.1 * x}), "sag")
    assert "The gap depends on the dwell time." in text
    with registered(text, tmp_path) as effect:
        found, path = added(effect), motion(1)
        rest = np.abs(path.velocity_mm_s) < 1e-9
        ends = np.flatnonzero(rest[:-1] & ~rest[1:])
        assert ends.size
        assert found[ends].max() == pytest.approx(0.2, abs=0.02)  # the longest rest takes 2 s
        assert not found[~rest].any()


@pytest.mark.parametrize("axis", [each for each in GapAxis if each is not GapAxis.ANGLE])
def test_the_words_name_the_axis(axis: GapAxis) -> None:
    assert f"depends on the {axis.label}." in effect_file_text(curves(axis, 0, 10, {"any": lambda x: x}))
