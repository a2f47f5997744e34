import inspect
import math
import tomllib
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from needleplan import models
from needleplan.errors import ModelError
from needleplan.models import KINDS, Bicycle, Estimate, Model, ModelFile, Parent, Scale
from needleplan.models.friction import BlendedReversal

SCHEMA = "needleplan.model/1"
MODEL = Bicycle(1 / 1200, 0.01)
FILE = ModelFile(
    MODEL,
    {"curvature_per_mm": Estimate(1 / 1200, 2e-5, 7.9e-4, 8.8e-4, "1/mm", True)},
    (Parent("trial 3", "sha256:00", "../data.csv"), Parent('a "quoted" name', "")),
    ("one remark", "two"),
    "Gel, 18 gauge",
)


def subclasses(kind: type[Model]) -> set[type[Model]]:
    return {kind, *(each for sub in kind.__subclasses__() for each in subclasses(sub))}


def test_every_member_of_the_family_is_a_kind() -> None:
    assert models.__name__
    members = {
        each for each in subclasses(Model)
        if each.__module__.startswith("needleplan.models") and not inspect.isabstract(each)
        and isinstance(getattr(each, "name", None), str)
    }  # fmt: skip
    members -= {BlendedReversal}  # a step of the diagnosis: its weights are no parameters, and no file holds it
    assert {each.name for each in members} == KINDS.keys()
    assert set(KINDS.values()) == members


def test_a_file_reads_back_as_it_was(tmp_path: Path) -> None:
    FILE.write(tmp_path / "model.toml")
    found = ModelFile.read(tmp_path / "model.toml")
    assert found == FILE
    assert found.digest == FILE.digest
    assert tomllib.loads(FILE.to_toml())["parameters"]["heading_rad"]["value"] == 0.01


@pytest.mark.parametrize("kind", sorted(KINDS))
def test_every_kind_has_a_file(kind: str) -> None:
    member = KINDS[kind]
    values = {name: 1.0 if what.lower <= 1 <= what.upper else what.upper for name, what in member.parameters().items()}
    model = member(**values)
    estimates = {
        name: Estimate(value, float("inf"), -float("inf"), float("inf"), member.parameters()[name].unit, False)
        for name, value in model.values().items()
    }
    again = ModelFile.from_toml(ModelFile(model, estimates).to_toml())
    assert again.model == model
    assert again.estimates == estimates


@pytest.mark.parametrize("kind", sorted(KINDS))
def test_a_model_at_a_bound_can_be_computed_with_and_read_again(kind: str) -> None:
    """A coordinate of a bound, as a fit or a mean of fits has it, leads back to the bound, and not beyond it."""
    member = KINDS[kind]
    inside = {name: 1.0 if what.lower <= 1 <= what.upper else what.upper for name, what in member.parameters().items()}
    for name, what in member.parameters().items():
        for bound in (what.lower, what.upper):
            if math.isinf(bound) or (bound == 0 and what.scale is Scale.LOG):
                continue
            at_bound = what.value(what.coordinate(bound))
            assert at_bound == bound
            estimate = Estimate(at_bound, math.inf, what.lower, what.upper, what.unit, False)
            beyond = math.nextafter(bound, 2 * bound - inside[name]) if bound else 0.0
            try:
                model = member(**inside | {name: beyond})
            except ModelError as error:
                assert "must be from" not in str(error)  # parameters that exclude each other
                continue
            assert getattr(model, name) == bound
            again = ModelFile.from_toml(ModelFile(model, {name: estimate}).to_toml())
            assert again.model == model


def test_all_mistakes_are_reported_at_once() -> None:
    text = f"""schema = "{SCHEMA}"
kind = "bicycle"
titel = "x"
remarks = "none"
[parameters.curvature_per_mm]
value = "high"
unit = "1/m"
[parameters.heading_rad]
value = 0.0
unit = "rad"
sd = 0.1
low = 0.2
high = 0.3
[parameters.ofset_mm]
value = 1.0
[[parent]]
name = 3
digst = "x"
"""
    with pytest.raises(ModelError) as raised:
        ModelFile.from_toml(text, "m.toml")
    assert str(raised.value).splitlines() == [
        "m.toml: 8 mistakes",
        '  titel: unknown key; did you mean "title"?',
        '  remarks = "none": must be a list of texts',
        '  parent 1.digst: unknown key; did you mean "digest"?',
        "  parent 1.name = 3: must be a text of at most 100000 characters",
        '  parameters.ofset_mm: unknown key; did you mean "offset_mm"?',
        '  parameters.curvature_per_mm.unit = "1/m": must be "1/mm"',
        '  parameters.curvature_per_mm.value = "high": must be a number in 1/mm',
        "  parameters.heading_rad.low, high = 0.2, 0.3: must enclose the value, and sd must be 0 or more",
    ]


CASES = [
    ("schema", f'kind = "bicycle"\n{FILE.to_toml().split(chr(10), 2)[2]}', f'schema: must be "{SCHEMA}"'),
    ("kind", FILE.to_toml().replace('"bicycle"', '"bicicle"'), 'kind = "bicicle": must be one of'),
    ("range", FILE.to_toml().replace("value = 0.01\n", "value = 7.0\n"), "must be from -1.6 to 1.6 rad"),
    ("missing", f'schema = "{SCHEMA}"\nkind = "bicycle"\n', "parameters.curvature_per_mm: is missing"),
    ("no toml", "schema = ", "is not TOML"),
]  # fmt: skip


@pytest.mark.parametrize(("text", "message"), [case[1:] for case in CASES], ids=[case[0] for case in CASES])
def test_a_mistake_has_a_clear_message(text: str, message: str) -> None:
    with pytest.raises(ModelError) as raised:
        ModelFile.from_toml(text, "m.toml")
    assert message in str(raised.value)


def test_options_are_checked() -> None:
    text = ModelFile(KINDS["karnopp"](mu_c=1.0, sigma2=0.1)).to_toml()
    assert "[options]" in text
    with pytest.raises(ModelError, match=r'options.profile = "round": must be one of'):
        ModelFile.from_toml(text.replace('profile = "constant"', 'profile = "round"'))


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match="No such file"):
        ModelFile.read(tmp_path / "no.toml")
    (tmp_path / "latin.toml").write_bytes(b"title = '\xe9'")
    with pytest.raises(ModelError, match="UTF-8"):
        ModelFile.read(tmp_path / "latin.toml")


@settings(max_examples=200, deadline=None)
@given(st.data())
def test_damaged_files_give_model_errors(data: st.DataObject) -> None:
    text = FILE.to_toml()
    place = data.draw(st.integers(0, len(text)))
    cut = data.draw(st.integers(0, 40))
    altered = text[:place] + data.draw(st.text(max_size=20)) + text[place + cut :]
    try:
        found = ModelFile.from_toml(altered)
    except ModelError as error:
        assert error.mistakes
    else:
        assert isinstance(found.model, Bicycle)
