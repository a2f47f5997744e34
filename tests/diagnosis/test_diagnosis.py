from __future__ import annotations

import json

import numpy as np
import pytest

from needleplan.diagnosis import Library, Verdict, diagnose, document_of
from needleplan.diagnosis.data import fit_noise
from needleplan.errors import DataError, ModelError
from needleplan.models import ModelFile, simulate
from needleplan.models.effects import AugmentedModel, effect_named
from needleplan.signals import Record, Role
from tests.diagnosis.trials import BASE, NOISE_N, coloured, motion, recordings

NAMES = ("puncture", "cutting_layer", "friction_layer", "viscous", "stribeck", "bias", "drift", "relaxation", "inertia")
LIBRARY = Library([effect_named(name) for name in NAMES], BASE)


def test_noise_is_whitened() -> None:
    noise = fit_noise([coloured(np.random.default_rng(5), 4000)])
    fresh = noise.whiten(coloured(np.random.default_rng(6), 4000))
    assert noise.rms == pytest.approx(NOISE_N, rel=0.1)
    assert fresh.std() == pytest.approx(1.0, rel=0.05)
    assert abs(float(fresh[1:] @ fresh[:-1]) / len(fresh)) < 0.05


@pytest.mark.parametrize("seed", range(3))
def test_nothing_is_named_where_nothing_is_missing(seed: int) -> None:
    found = diagnose(BASE, recordings(seed=seed), library=LIBRARY)
    assert found.verdict in (Verdict.NONE, Verdict.UNDERPOWERED)
    assert not found.effects
    assert not isinstance(found.model, AugmentedModel)


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("puncture", {"size": 0.3, "depth_mm": 33.3, "bulge_mm": 2.5}),
        ("viscous", {"size": 2e-4}),
        ("bias", {"size": 0.04}),
        ("relaxation", {"size": 0.25, "time_s": 0.8, "recovery_mm": 0.1}),
        ("inertia", {"size": 1.5}),
    ],
)
def test_an_effect_is_named_measured_and_added(name: str, values: dict[str, float]) -> None:
    found = diagnose(BASE, recordings({name: values}, seed=2), library=LIBRARY)
    assert found.verdict is Verdict.NAMED
    assert found.names == (name,)
    for key, value in values.items():
        estimate = found.effects[0].estimates[key]
        assert abs(estimate.value - value) < 5 * max(estimate.sd, 0.02 * abs(value))
    assert found.decision.explained is not None  # smooth functions see next to nothing of a puncture
    assert found.decision.explained > 0.9
    assert found.validation is not None
    assert found.validation.after_rms < found.validation.before_rms
    assert found.validation.shrink > 0.8
    model = found.model
    assert isinstance(model, AugmentedModel)
    assert model.effects[0].found_by == found.digest
    again = ModelFile.from_toml(ModelFile(model).to_toml()).model
    np.testing.assert_array_equal(simulate(again, motion(0)).output, simulate(model, motion(0)).output)


@pytest.mark.slow
def test_two_effects_are_named_one_after_the_other() -> None:
    hidden = {"viscous": {"size": 3e-4}, "puncture": {"size": 0.4, "depth_mm": 40.0, "bulge_mm": 2.0}}
    found = diagnose(BASE, recordings(hidden, seed=1), library=LIBRARY)
    assert set(found.names) == set(hidden)


def test_the_same_data_give_the_same_document() -> None:
    data = recordings({"viscous": {"size": 2e-4}}, seed=3)
    texts = {json.dumps(document_of(diagnose(BASE, data, library=LIBRARY)), allow_nan=False) for _ in range(2)}
    assert len(texts) == 1
    document = json.loads(texts.pop())
    assert document["schema"] == "needleplan.diagnosis/1"
    assert document["effects"][0]["parameters"]["size"]["unit"] == "N s/mm2"


@pytest.mark.parametrize("left_out", [Role.NOISE, Role.HOLDOUT])
def test_missing_data_prevent_a_name(left_out: Role) -> None:
    data = [each for each in recordings({"viscous": {"size": 3e-4}}, seed=4) if each.role is not left_out]
    found = diagnose(BASE, data, library=LIBRARY)
    assert found.verdict is not Verdict.NAMED
    assert found.checked.lacks
    with pytest.raises(ModelError, match="only named effects"):
        found.merged()


def test_a_held_out_trial_of_the_same_motion_proves_nothing() -> None:
    data = recordings({"viscous": {"size": 3e-4}}, seed=4)
    again = recordings({"viscous": {"size": 3e-4}}, seed=5)[0]
    data[2] = Record(again.columns, "again", Role.HOLDOUT)
    found = diagnose(BASE, data, library=LIBRARY)
    assert found.verdict is Verdict.AMBIGUOUS
    assert found.decision.tied == ("viscous",)
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
def test_unusable_data_are_refused(spoil, says: str) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(DataError, match=says):
        diagnose(BASE, spoil(recordings()), library=LIBRARY)


def test_missing_measurements_do_not_count() -> None:
    data = recordings({"bias": {"size": 0.05}}, seed=2)
    force = data[0]["force_n"].copy()
    force[100:140] = np.nan
    found = diagnose(BASE, [data[0].with_column("force_n", force), *data[1:]], library=LIBRARY)
    assert found.names == ("bias",)


def test_estimates_stay_within_bounds() -> None:
    name = "relaxation"
    strong = {"size": 1.0, "time_s": 1.0, "recovery_mm": 0.1}
    found = diagnose(BASE, recordings({name: strong}, seed=5), library=Library([effect_named(name)], BASE))
    for each in found.effects:
        what = each.effect.parameters
        assert all(what[key].lower <= value <= what[key].upper for key, value in each.values.items())
