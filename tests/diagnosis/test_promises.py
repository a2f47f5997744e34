"""What a user is promised of a diagnosis of the axial force."""

import json
from collections.abc import Callable

import numpy as np
import pytest

from needleplan.diagnosis import Diagnosis, Library, Verdict, diagnose
from needleplan.errors import DataError, ModelError
from needleplan.models import ModelFile, simulate
from needleplan.models.effects import AugmentedModel, effect_named
from needleplan.reports.diagnosis import document_of, traces_of
from needleplan.signals import Record, Role
from tests.diagnosis.trials import BASE, RATE_HZ, motion, recordings

NAMES = ("puncture", "cutting_layer", "friction_layer", "viscous", "stribeck", "bias", "drift", "relaxation", "inertia")
LIBRARY = Library([effect_named(name) for name in NAMES], BASE)
FEW = Library([effect_named(name) for name in ("viscous", "bias")], BASE)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_nothing_is_named_where_nothing_is_missing(seed: int) -> None:
    found = diagnose(BASE, recordings(seed=seed), library=LIBRARY)
    assert found.verdict in (Verdict.NONE, Verdict.UNDERPOWERED)
    assert not found.effects
    assert not isinstance(found.model, AugmentedModel)


@pytest.mark.study
def test_a_puncture_is_measured_to_a_tenth_of_a_millimetre() -> None:
    truth = {"size": 1.5, "depth_mm": 40.0, "bulge_mm": 2.0}
    found = diagnose(BASE, recordings({"puncture": truth}, seed=3), library=LIBRARY)
    assert found.names == ("puncture",)
    for name, each in found.effects[0].estimates.items():
        assert each.low < truth[name] < each.high
    depth = found.effects[0].estimates["depth_mm"]
    assert depth.high - depth.low < 0.2


@pytest.mark.slow
@pytest.mark.study
@pytest.mark.parametrize(
    ("name", "values"),
    [
        pytest.param("puncture", {"size": 0.3, "depth_mm": 33.3, "bulge_mm": 2.5}, marks=pytest.mark.slow),
        ("viscous", {"size": 2e-4}),
        pytest.param("bias", {"size": 0.04}, marks=pytest.mark.slow),
        pytest.param("relaxation", {"size": 0.25, "time_s": 0.8, "recovery_mm": 0.1}, marks=pytest.mark.slow),
        ("inertia", {"size": 1.5}),
    ],
)
def test_an_effect_is_named_measured_and_added(name: str, values: dict[str, float]) -> None:
    found = diagnose(BASE, recordings({name: values}, seed=2), library=LIBRARY)
    assert (found.verdict, found.names) == (Verdict.NAMED, (name,))
    (effect,) = found.effects
    for key, value in values.items():
        estimate = effect.estimates[key]
        assert estimate.low < estimate.high
        assert abs(estimate.value - value) < 5 * estimate.sd
    assert found.marginals[name] >= 0.9
    assert effect.share == 1
    assert found.shrink > 0.8
    model = found.model
    assert isinstance(model, AugmentedModel)
    assert model.effects[0].found_by == found.digest
    again = ModelFile.from_toml(ModelFile(model).to_toml()).model
    np.testing.assert_array_equal(simulate(again, motion(0)).output, simulate(model, motion(0)).output)


@pytest.mark.study
def test_two_effects_are_named_and_share_the_gap() -> None:
    hidden = {"viscous": {"size": 3e-4}, "puncture": {"size": 0.4, "depth_mm": 40.0, "bulge_mm": 2.0}}
    found = diagnose(BASE, recordings(hidden, seed=1), library=LIBRARY)
    assert set(found.names) == set(hidden)
    assert sum(each.share for each in found.effects) == pytest.approx(1)
    assert len(found.model.effects) == 2  # type: ignore[attr-defined]


@pytest.mark.slow
def test_the_same_data_give_the_same_document() -> None:
    data = recordings({"viscous": {"size": 2e-4}}, seed=3)
    texts = set()
    for _ in range(2):
        found = diagnose(BASE, data, library=LIBRARY)
        texts.add(json.dumps(document_of(found, traces_of(found), None), allow_nan=False))
    assert len(texts) == 1
    document = json.loads(texts.pop())
    assert document["schema"] == "needleplan.diagnosis/2"
    assert document["effects"][0]["parameters"]["size"]["unit"] == "N s/mm2"


@pytest.mark.slow
@pytest.mark.study
@pytest.mark.parametrize("left_out", [pytest.param(Role.NOISE, marks=pytest.mark.slow), Role.HOLDOUT])
def test_missing_data_prevent_a_name(left_out: Role) -> None:
    data = [each for each in recordings({"viscous": {"size": 3e-4}}, seed=4) if each.role is not left_out]
    found = diagnose(BASE, data, library=LIBRARY)
    assert found.verdict is not Verdict.NAMED
    assert found.checked.lacks
    assert not found.effects
    with pytest.raises(ModelError, match="only named effects"):
        found.merged()
    merged = found.merged(anyway=True)
    assert isinstance(merged, AugmentedModel)
    assert "viscous" in [each.name for each in merged.effects]


@pytest.mark.slow
def test_a_held_out_trial_of_the_same_motion_proves_nothing() -> None:
    data = recordings({"viscous": {"size": 3e-4}}, seed=4)
    again = recordings({"viscous": {"size": 3e-4}}, seed=5)[0]
    data[2] = Record(again.columns, "again", Role.HOLDOUT)
    found = diagnose(BASE, data, library=LIBRARY)
    assert found.verdict is Verdict.AMBIGUOUS
    assert found.lacks_data
    assert found.decision.tied[0] == ("viscous",)
    assert "no held-out trial of another motion" in found.decision.because
    assert "repeat a training motion" in " ".join(found.checked.lacks.values())


def _short(data: list[Record]) -> list[Record]:
    return [data[0].select(slice(0, 50)), *data[1:]]


def _gap(data: list[Record]) -> list[Record]:
    keep = np.r_[0:300, 500 : len(data[0])]
    return [data[0].select(keep), *data[1:]]


def _other_rate(data: list[Record]) -> list[Record]:
    return [*data[:3], data[3].select(slice(None, None, 2))]


def _constant(data: list[Record]) -> list[Record]:
    return [data[0].with_column("force_n", np.ones(len(data[0]))), *data[1:]]


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (_short, "too short"),
        (_gap, "has a gap"),
        (_other_rate, "must be sampled as"),
        (_constant, "is constant: the reading of a working sensor varies"),
        (lambda data: data[2:], "no trial has the role train"),
    ],
)
def test_unusable_data_are_refused(spoil: Callable[[list[Record]], list[Record]], says: str) -> None:
    with pytest.raises(DataError, match=says):
        diagnose(BASE, spoil(recordings()), library=LIBRARY)


def test_one_message_lists_all_mistakes() -> None:
    data = recordings()
    spoilt = [*_short(data)[:1], *_constant(data[1:])]
    with pytest.raises(DataError) as refused:
        diagnose(BASE, spoilt, library=LIBRARY)
    rules = [each.rule for each in refused.value.mistakes]
    assert len(rules) == 2
    assert "too short" in rules[0]
    assert "is constant" in rules[1]


def test_averaging_does_not_hide_uneven_sampling() -> None:
    time = np.linspace(0, 60, 12_001) + 0.0045 * (np.arange(12_001) % 2)
    slow = [each.select(slice(0, 3000)) for each in recordings()]
    fast = [
        Record({**{name: np.interp(time, each["time_s"], each[name]) for name in each.columns}, "time_s": time},
               each.trial, each.role)
        for each in slow
    ]  # fmt: skip
    with pytest.raises(DataError, match="unevenly"):
        diagnose(BASE, fast, library=FEW)


@pytest.mark.slow
def test_missing_measurements_do_not_count() -> None:
    data = recordings({"bias": {"size": 0.05}}, seed=2)
    force = data[0]["force_n"].copy()
    force[100:140] = np.nan
    found = diagnose(BASE, [data[0].with_column("force_n", force), *data[1:]], library=LIBRARY)
    assert found.names == ("bias",)


@pytest.mark.slow
def test_estimates_stay_within_bounds() -> None:
    name = "relaxation"
    strong = {"size": 1.0, "time_s": 1.0, "recovery_mm": 0.1}
    found = diagnose(BASE, recordings({name: strong}, seed=5), library=Library([effect_named(name)], BASE))
    assert found.likely
    for each in found.likely:
        what = each.effect.parameters
        assert all(what[key].lower <= value <= what[key].upper for key, value in each.values.items())
        for key, estimate in each.estimates.items():
            assert what[key].lower <= estimate.low <= estimate.high <= what[key].upper


@pytest.fixture(scope="module")
def punctured() -> Diagnosis:
    hidden = {"puncture": {"size": 1.5, "depth_mm": 40.0, "bulge_mm": 2.0}}
    return diagnose(BASE, recordings(hidden, seed=3), library=Library([effect_named("puncture")], BASE))


@pytest.mark.study
def test_the_interval_of_a_place_is_no_shorter_than_a_part_of_a_sample(punctured: Diagnosis) -> None:
    assert punctured.verdict is Verdict.NAMED
    place = punctured.effects[0].estimates["depth_mm"]
    slowest_mm_s = 5.0  # of the two trials, on the way past 40 mm
    assert abs(place.value - 40.0) < 5 * place.sd
    assert 0.5 * slowest_mm_s / RATE_HZ < place.high - place.low < 1.0


def test_stages_are_told_in_order() -> None:
    told: list[str] = []
    diagnose(BASE, recordings(seed=1), library=FEW, progress=told.append)
    assert told[0] == "calibrating the model to the trials"
    assert told[1] == "searching missing effects"
