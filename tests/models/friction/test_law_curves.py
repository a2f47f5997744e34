"""Curves of friction and cutting force, against a loop over the samples, in files, and with mistakes."""

import numpy as np
import pytest

from needleplan.errors import ModelError
from needleplan.models import ModelFile, ShaftAndTip, simulate
from needleplan.models.friction import LawCurves
from needleplan.signals import insertion_cycles

LAWS = {"friction": 0.02, "cutting": 0.5, "onset_mm": 3.0, "presliding_mm": 0.2}
CURVES = LawCurves(
    depth_mm=(0.0, 10.0, 40.0), friction_by_depth=(0.0, 0.3, -0.2), cutting_by_depth=(0.5, 0.0, 0.1),
    speed_mm_s=(2.0, 8.0), friction_by_speed=(0.2, 0.0), cutting_by_speed=(-0.1, 0.1),
    force_n=(-1.0, 2.0), both_by_force=(0.1, -0.1), friction_by_direction=0.15, cutting_pulled=0.3,
)  # fmt: skip
MODEL = ShaftAndTip(**LAWS, curves=CURVES)
MOTION = insertion_cycles(35.0, 5.0)


def line(value, places, shares):
    """Return the value of a curve, by a search for its piece."""
    if value <= places[0]:
        return shares[0]
    for left, right, low, high in zip(places[:-1], places[1:], shares[:-1], shares[1:], strict=True):
        if value <= right:
            return low + (high - low) * (value - left) / (right - left)
    return shares[-1]


def test_the_force_is_that_of_the_formulas_sample_by_sample():
    bristle, speed, found = simulate(MODEL, MOTION).states[0], 2.0, []
    for k, z in enumerate(bristle):
        depth, now = max(MOTION.depth_mm[k], 0.0), min(max(abs(MOTION.velocity_mm_s[k]), 2.0), 8.0)
        travel = max(MOTION.depth_mm[k], 0.0) - max(MOTION.depth_mm[k - 1], 0.0) if k else 0.0
        keep = np.exp(-abs(travel) / 0.5)
        speed = keep * speed + (1 - keep) * now if k else now
        shaft, full = 0.02 * depth * z, 0.5 * (1 - np.exp(-depth / 3.0))
        tip = full * (1 + z) / 2
        both = line(shaft + tip, CURVES.force_n, CURVES.both_by_force)
        friction = line(depth, CURVES.depth_mm, CURVES.friction_by_depth) + 0.15 * np.sign(shaft)
        friction += line(speed, CURVES.speed_mm_s, CURVES.friction_by_speed)
        cutting = line(depth, CURVES.depth_mm, CURVES.cutting_by_depth)
        cutting += line(speed, CURVES.speed_mm_s, CURVES.cutting_by_speed)
        found.append(shaft * (1 + both + friction) + tip * (1 + both + cutting) + 0.3 * (full - tip))
    np.testing.assert_allclose(simulate(MODEL, MOTION).output, found, atol=1e-9)


def test_empty_curves_change_nothing():
    plain = simulate(ShaftAndTip(**LAWS), MOTION).output
    assert (simulate(ShaftAndTip(**LAWS, curves=LawCurves()), MOTION).output == plain).all()


def test_a_model_file_holds_the_curves():
    text = ModelFile.of(MODEL).to_toml()
    assert ModelFile.from_toml(text).model == MODEL
    assert "curves" not in ModelFile.of(ShaftAndTip(**LAWS)).to_toml()


def test_curves_after_others_act_one_after_the_other():
    first = LawCurves(depth_mm=(0.0, 20.0), friction_by_depth=(0.1, 0.4))
    second = LawCurves(depth_mm=(0.0, 5.0, 30.0), friction_by_depth=(0.0, 0.2, -0.1), cutting_by_depth=(0.3, 0.0, 0.0))
    for depth in (0.0, 5.0, 20.0, 30.0):  # the nodes; between them the product of two lines is no line
        share = [line(depth, each.depth_mm, each.friction_by_depth) for each in (first, second, second.after(first))]
        assert share[2] == pytest.approx((1 + share[0]) * (1 + share[1]) - 1)
    assert second.after(first).cutting_by_depth == pytest.approx((0.3, 0.0, 0.0, 0.0))
    assert second.after(None) is second


@pytest.mark.parametrize(
    ("given", "key", "rule"),
    [
        ({"depth_mm": (0.0, 10.0), "friction_by_depth": (0.1,)}, "friction_by_depth", "one for each of the 2"),
        ({"depth_mm": (10.0, 0.0)}, "depth_mm", "must increase"),
        ({"speed_mm_s": (1.0, float("nan"))}, "speed_mm_s", "must be"),
        ({"cutting_pulled": "much"}, "cutting_pulled", "must be"),
    ],
)
def test_mistakes_are_named(given, key, rule):
    with pytest.raises(ModelError, match=rule) as raised:
        LawCurves(**given)
    assert raised.value.mistakes[0].key.endswith(key)


def test_a_wrong_curve_in_a_file_is_named_with_its_table():
    text = ModelFile.of(MODEL).to_toml().replace("cutting_pulled = 0.3", 'cutting_pulled = "x"')
    with pytest.raises(ModelError, match="must be") as raised:
        ModelFile.from_toml(text)
    assert raised.value.mistakes[0].key == "options.curves.cutting_pulled"
