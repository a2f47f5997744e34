from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from needleplan.errors import ModelError
from needleplan.identification.combination import Combination
from needleplan.identification.force_library import ForceLibrary
from needleplan.models import simulate
from needleplan.models.force import ForceModel1
from needleplan.signals import insertion_cycles
from needleplan_thesis.chapter2.forces import PUBLISHED_FORCES

MODEL = PUBLISHED_FORCES[0].model
ONE = Combination("18 GA", "gellan 4.5 %", 10.0, 80.0, MODEL, "a test", {"beta": (0.02, 0.03)}, 0.002, ("sha256:ab",))


def test_a_file_goes_and_comes_back(tmp_path: Path) -> None:
    other = replace(ONE, velocity_mm_s=6.0, intervals={}, mae_n=None, digests=())
    library = ForceLibrary((ONE, other), 'with "quotes" and \\')
    library.write(tmp_path / "library.toml")
    assert ForceLibrary.read(tmp_path / "library.toml") == library
    ForceLibrary.read("published").write(tmp_path / "published.toml")
    assert ForceLibrary.read(tmp_path / "published.toml") == ForceLibrary.read("published")


@settings(max_examples=25, deadline=None)
@given(
    needle=st.text(min_size=1).filter(lambda each: bool(each.strip())),
    sigma0=st.floats(1e-6, 1.0), depth=st.floats(1.0, 200.0), beta=st.floats(1e-3, 1.0),
)  # fmt: skip
def test_anything_that_is_a_library_survives_its_file(
    tmp_path_factory: pytest.TempPathFactory, needle: str, sigma0: float, depth: float, beta: float
) -> None:
    model = ForceModel1(**{**MODEL.values(), "sigma0": sigma0, "beta": beta})
    try:
        needle.encode()
    except UnicodeEncodeError:
        needle = "needle"
    library = ForceLibrary((Combination(needle, "t", 3.0, depth, model, "s"),))
    path = tmp_path_factory.mktemp("library") / "library.toml"
    library.write(path)
    assert ForceLibrary.read(path) == library


def test_every_mistake_is_told_at_once(tmp_path: Path) -> None:
    path = tmp_path / "library.toml"
    path.write_text("""
schema = "needleplan.force-library/2"
titel = "x"

[[combination]]
needle = "18 GA"
tissue = 3
velocity_mm_s = -1
model = "force_model_3"
source = "x"

[[combination]]
needle = "18 GA"
tissue = "gellan"
velocity_mm_s = 10
depth_mm = 80
model = "force_model_2"
source = "x"
speed = 3
digests = ["md5:1"]
[combination.parameters]
sigma0 = 7.9e-3
sigma1 = "much"
sigma2 = 4e-3
f1 = 1e9
f2 = -2.11e-2
alhpa = 5e-2
beta = 2.55e-2
[combination.intervals]
beta = [1, 2, 3]
""")
    with pytest.raises(ModelError) as raised:
        ForceLibrary.read(path)
    assert [each.key for each in raised.value.mistakes] == [
        "schema", "titel", "combination 1.tissue", "combination 1.velocity_mm_s", "combination 1.depth_mm",
        "combination 1.model", "combination 2.speed", "combination 2.digests", "combination 2.parameters.alhpa",
        "combination 2.parameters.sigma1", "combination 2.parameters.f1", "combination 2.parameters.alpha",
        "combination 2.intervals.beta",
    ]  # fmt: skip
    said = str(raised.value)
    assert 'did you mean "title"' in said
    assert 'did you mean "force_model_1"' in said or 'did you mean "force_model_2"' in said
    assert 'did you mean "alpha"' in said
    assert str(path) in said


@pytest.mark.parametrize(("change", "key"), [
    ({"model": MODEL.with_values(f1=0.01)}, "parameters.f1"),
    ({"intervals": {"beta": (0.03, 0.04)}}, "intervals.beta"),
    ({"intervals": {"gamma": (0.03, 0.04)}}, "intervals.gamma"),
    ({"needle": " "}, "needle"),
    ({"velocity_mm_s": float("inf")}, "velocity_mm_s"),
    ({"mae_n": -1.0}, "mae_n"),
])  # fmt: skip
def test_what_is_no_combination(change: dict[str, object], key: str) -> None:
    with pytest.raises(ModelError) as raised:
        replace(ONE, **change)  # type: ignore[arg-type]
    assert [each.key for each in raised.value.mistakes] == [key]


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match="no shipped library of that name"):
        ForceLibrary.read(tmp_path / "missing.toml")
    (tmp_path / "a.toml").write_bytes(b"\xff\xfe")
    with pytest.raises(ModelError, match="UTF-8"):
        ForceLibrary.read(tmp_path / "a.toml")
    (tmp_path / "b.toml").write_text("schema = ")
    with pytest.raises(ModelError, match="not TOML"):
        ForceLibrary.read(tmp_path / "b.toml")
    (tmp_path / "c.toml").write_text('schema = "needleplan.force-library/1"\ncombination = 3\n')
    with pytest.raises(ModelError, match="must be tables"):
        ForceLibrary.read(tmp_path / "c.toml")


def test_search_and_nearest() -> None:
    library = ForceLibrary.read("published")
    assert len(library.search(needle="22 ga, 0.718/0.413 MM")) == 3
    assert len(library.search(tissue="4.5 %")) == 3
    assert not library.search(needle="18 GA", tissue="6 %")
    assert [each.velocity_ratio for each in library.matches(needle="22 ga", velocity_mm_s=12.0)] == [10 / 12] * 2
    assert len(library.matches(needle="22 ga")) == 3
    found = library.matches(tissue="4.5 %", velocity_mm_s=10.0)
    assert [(each.combination.needle, each.combination.tissue, each.combination.velocity_mm_s) for each in found] == [
        ("18 GA, 1.270/0.838 mm", "gellan gum 4.5 %", 10.0),
        ("22 GA, 0.718/0.413 mm", "gellan gum 4.5 %", 10.0),
    ]
    assert [each.velocity_ratio for each in found] == [1.0, 1.0]
    match = library.nearest("18 GA, 1.270/0.838 mm", "gellan gum 4.5 %", 7.0)
    assert match is not None
    assert match.combination.velocity_mm_s == 6.0
    assert match.velocity_ratio == pytest.approx(6 / 7)
    assert library.nearest("18 GA, 1.270/0.838 mm", "gellan gum 6 %", 7.0) is None
    with pytest.raises(ModelError, match="positive"):
        library.nearest("a", "b", 0.0)


def test_a_combination_is_there_once() -> None:
    with pytest.raises(ModelError, match="as number 1"):
        ForceLibrary((ONE, replace(ONE, needle="18 ga")))
    better = replace(ONE, mae_n=0.001)
    assert ForceLibrary((ONE,)).with_combination(better).combinations == (better,)


def test_force_without_a_sensor() -> None:
    motion = insertion_cycles(90.0, 10.0)
    said = ONE.predict(motion)
    np.testing.assert_array_equal(said.force_n, simulate(MODEL, motion).output)
    np.testing.assert_array_equal(said.outside, motion.depth_mm > 80)
    assert ONE.predict(insertion_cycles(50.0, 12.0)).outside.mean() > 0.8
