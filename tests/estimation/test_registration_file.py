import math
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from needleplan.artifacts import Parent
from needleplan.errors import DataError, InputError
from needleplan.estimation import Registration, register

POINTS = ((0.0, 0.0, 0.0), (100.0, 0.0, 5.0), (0.0, 80.0, -5.0), (90.0, 70.0, 30.0))


def made(seed: int = 0) -> Registration:
    """A registration of four points with errors."""
    random = np.random.default_rng(seed)
    tracker = np.array(POINTS) @ Rotation.random(random_state=seed).as_matrix() + random.uniform(-200, 200, 3)
    tracker += random.normal(0, 0.3, tracker.shape)
    motion = register(tracker, np.array(POINTS))
    x, y, z, w = motion.rotation.as_quat().tolist()
    points = tuple((tuple(a), b) for a, b in zip(tracker.tolist(), POINTS, strict=True))
    parents = (Parent("pivot.csv", "sha256:12"), Parent('"quoted"\x7f', ""))
    return Registration(
        (w, x, y, z), tuple(motion.translation_mm.tolist()), 9.3, 0.06, -1, 0.3, 200, points, parents, "a needle"
    )


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 1000))
def test_a_file_reads_back_as_it_was(seed: int) -> None:
    found = made(seed)
    again = Registration.from_toml(found.to_toml())
    assert again == found
    assert again.digest == found.digest
    assert again.fre_mm == pytest.approx(found.fre_mm)


def test_a_coil_is_placed_as_scipy_places_it() -> None:
    found = made()
    w, x, y, z = found.quaternion
    turned = Rotation.from_quat([x, y, z, w])
    coil = Rotation.random(random_state=5)
    cx, cy, cz, cw = coil.as_quat().tolist()
    position, direction = found.place((1.0, 2.0, 3.0), (cw, cx, cy, cz))
    np.testing.assert_allclose(position, turned.apply([1, 2, 3]) + found.translation_mm, atol=1e-9)
    np.testing.assert_allclose(direction, -(turned * coil).apply([0, 0, 1]), atol=1e-12)


def test_errors_at_a_target_are_those_of_the_fit() -> None:
    found = made()
    assert found.motion
    near, far = found.tre_mm((50.0, 40.0, 5.0)), found.tre_mm((50.0, 40.0, 300.0))
    assert 0 < near < far
    assert near == pytest.approx(found.motion.tre_mm(found.motion.rotation.inv().apply(
        np.array([50.0, 40.0, 5.0]) - found.motion.translation_mm)))  # fmt: skip
    assert math.isnan(Registration().tre_mm((0.0, 0.0, 0.0)))


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("registration/1", "registration/2", 'schema = "needleplan.registration/2": must be'),
        ("offset_mm = 9.3", "offset_mm = -1", "coil.offset_mm = -1: must be a finite number in mm at least 0"),
        ("offset_mm = 9.3", "ofset_mm = 9.3", 'coil.ofset_mm: unknown key; did you mean "offset_mm"'),
        ("axis = -1", "axis = 0", "coil.axis = 0: must be 1 or -1"),
        ("[frame]", "[fram]", 'unknown key; did you mean "frame"'),
        ("quaternion = [", "quaternion = [0.0, ", "must be 4 numbers"),
        ("translation_mm = [", "translation_mm = [1", "must be what the points give"),
        ("[coil]", "[coil", "is not TOML"),
        ("[[point]]", "[[points]]", 'unknown key; did you mean "point"'),
    ],
)
def test_mistakes_are_named(old: str, new: str, says: str, tmp_path: Path) -> None:
    file = tmp_path / "wrong.toml"
    file.write_text(made().to_toml().replace(old, new, 1))
    with pytest.raises(DataError, match=re.escape(says)) as caught:
        Registration.read(file)
    assert caught.value.source == str(file)


def test_points_on_one_line_are_named_by_their_key() -> None:
    points = "".join(
        f"[[point]]\ntracker_mm = [{x}, 0.0, 0.0]\nplan_mm = [{x}, {x * x}, 0.0]\n" for x in (1.0, 2.0, 4.0)
    )
    text = Registration().to_toml() + points
    with pytest.raises(DataError, match=r"point.tracker_mm = 3 points: must not lie on one line"):
        Registration.from_toml(text)


@pytest.mark.slow
@settings(max_examples=50, deadline=None)
@given(st.text(max_size=200), st.integers(0, 900))
def test_any_text_is_read_or_refused(text: str, place: int) -> None:
    whole = made().to_toml()
    try:
        Registration.from_toml(whole[:place] + text + whole[place + 10 :])
    except InputError as error:
        assert str(error)


def test_a_quaternion_of_another_length_is_refused() -> None:
    with pytest.raises(DataError, match="must be of length 1"):
        Registration((1.0, 0.1, 0.0, 0.0))
    with pytest.raises(DataError, match="cannot be read"):
        Registration.read("/nowhere/registration.toml")
