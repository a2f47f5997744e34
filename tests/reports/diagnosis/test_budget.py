"""The gap of the given model is said first, and everything that closes a part of it is a finding."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from needleplan.diagnosis import Diagnosis, FindingKind, Library, Verdict, diagnose
from needleplan.models import Estimate, ModelFile, simulate
from needleplan.models.effects import effect_named
from needleplan.reports.diagnosis import compare, document_of, lines_of, traces_of
from needleplan.reports.diagnosis.report import report_of
from tests.diagnosis.trials import BASE, NOISE_N, recordings

FEW = Library([effect_named(name) for name in ("viscous", "stribeck")], BASE)
FILE = ModelFile(BASE, {"presliding_mm": Estimate(0.05, 0.001, 0.048, 0.052, "mm", True)})


@pytest.fixture(scope="module")
def slips_late() -> Diagnosis:
    """Recordings whose presliding length is 0.115 mm, where the model file says 0.050 (0.048 to 0.052)."""
    return diagnose(FILE, recordings(base=BASE.with_values(presliding_mm=0.115)), library=FEW)


@pytest.mark.slow
def test_a_gap_that_is_excused_as_another_parameter_is_said(slips_late: Diagnosis) -> None:
    assert slips_late.verdict is Verdict.CHANGED
    gap = slips_late.budget
    given, parameters, laws = gap.stages()
    trials = [record for record in slips_late.recordings if record.trial in gap.trials]
    off = np.concatenate([record["force_n"] - simulate(BASE, record.motion()).output for record in trials])
    assert given.rms == pytest.approx(np.sqrt((off**2).mean()), rel=0.02)
    assert gap.noise_rms == pytest.approx(NOISE_N, rel=0.1)
    assert parameters.share > 0.9
    assert laws.rms == pytest.approx(NOISE_N, rel=0.1)
    assert [(each.kind, each.name) for each in slips_late.findings] == [(FindingKind.PARAMETER, "presliding_mm")]
    (found,) = [each for each in slips_late.parameters if each.name == "presliding_mm"]
    assert found.departs
    assert found.low < 0.115 < found.high
    assert (found.file_low, found.file_high) == (0.048, 0.052)


def test_the_answer_begins_with_the_gap_in_text_document_and_report(slips_late: Diagnosis) -> None:
    lines = list(lines_of(slips_late, None))
    assert lines[0].startswith("gap: the given model is off by 0.06")
    assert "other values of its parameters close" in lines[1]
    outside = "outside the interval of the model file, 0.048 to 0.052"
    assert lines[2].startswith("changed: ")
    assert any(outside in line for line in lines[3:])
    document = document_of(slips_late, traces_of(slips_late), None)
    assert document["budget"]["all"][0]["rms"] == pytest.approx(slips_late.budget.stages()[0].rms)
    assert document["findings"][0]["name"] == "presliding_mm"
    assert any(outside in sentence for sentence in document["words"]["answer"])
    page = report_of(slips_late, FILE, FEW, None, traces_of(slips_late))
    assert page.index("The given model is off by") < page.index("Answer: ")
    assert outside in page
    assert page.count("<h2") <= 6
    assert page.index("Gap budget") < page.index("Hypotheses</h2>")


def test_without_an_interval_the_given_value_is_compared(slips_late: Diagnosis) -> None:
    without = replace(slips_late, intervals={})
    (found,) = [each for each in without.parameters if each.name == "presliding_mm"]
    assert found.departs
    assert (found.given, found.file_low, found.file_high) == (0.05, None, None)
    assert str(found).endswith("the model has 0.05, without an interval")


def test_a_model_that_is_right_has_no_gap_to_share() -> None:
    records = recordings()
    generator = np.random.default_rng(3)
    right = []
    for record in records:
        force = generator.normal(0, NOISE_N, len(record))
        if record.trial != "noise":
            force = force + simulate(BASE, record.motion()).output
        right.append(record.with_column("force_n", force))
    found = diagnose(FILE, right, library=FEW)
    given = found.budget.stages()[0]
    assert given.rms == pytest.approx(NOISE_N, rel=0.05)
    assert math.isnan(given.share)
    assert (found.verdict, found.findings) == (Verdict.NONE, ())
    assert "this is no more than the noise" in list(found.budget.sentences())


@pytest.mark.slow
def test_a_law_that_takes_up_a_share_of_a_gap_is_named() -> None:
    """The cutting force comes up by another law than that of the model: no effect is missing, and it is said."""
    bent = []
    for record in recordings(seed=2):
        depth = np.maximum(record["depth_mm"], 0.0) / 4.0
        advancing = record.columns.get("velocity_mm_s", np.zeros(len(record))) > 0
        other = 0.4 * (np.tanh(depth**2) - (1 - np.exp(-depth)))
        bent.append(record.with_column("force_n", record["force_n"] + advancing * other))
    found = diagnose(BASE, bent, library=Library([effect_named("viscous")], BASE))
    assert found.verdict is Verdict.CHANGED
    assert "entry" in [each.name for each in found.findings if each.kind is FindingKind.LAW]
    assert found.budget.stages()[-1].share > 0.1


def test_the_interval_in_the_data_is_no_shorter_than_the_noise_permits(slips_late: Diagnosis) -> None:
    """By the sensitivity of the output to the presliding length alone: the other parameters only lengthen it."""
    trials, at = slips_late.named.trials[: len(slips_late.calibration.training)], 0.115
    energy = 0.0
    for trial in trials:
        later, sooner = (
            simulate(BASE.with_values(presliding_mm=at + step), trial.motion).output for step in (5e-4, -5e-4)
        )
        energy += float((((later - sooner) / 1e-3) ** 2).sum())
    found = slips_late.estimates()["presliding_mm"]
    assert (found.high - found.low) / 2 > 1.9 * NOISE_N / math.sqrt(energy)


def test_the_stages_of_a_role_are_those_of_its_trials(slips_late: Diagnosis) -> None:
    budget = slips_late.budget
    (held_out,) = [name for name, role in budget.roles.items() if role == "holdout"]
    assert [each.rms for each in budget.stages("holdout")] == pytest.approx(list(budget.trials[held_out].values()))
    assert budget.stages("reference") == ()


@pytest.fixture(scope="module")
def viscous() -> Diagnosis:
    """Recordings with viscous friction, which the model lacks."""
    return diagnose(BASE, recordings({"viscous": {"size": 2e-4}}, seed=2), library=FEW)


def nested(found: Diagnosis) -> bool:
    """Whether no stage leaves more in training than the one before, in result and document."""
    stages = found.budget.stages("train")
    document = document_of(found, traces_of(found), None)
    assert [each["rms"] for each in document["budget"]["training"]] == [each.rms for each in stages]
    assert [each.name for each in stages] == ["given", "parameters", "effects", "laws"]
    return all(after.rms <= before.rms for before, after in pairwise(stages))


@pytest.mark.slow
def test_no_stage_leaves_more_in_training_than_the_one_before(viscous: Diagnosis) -> None:
    assert nested(viscous)
    assert viscous.budget.stages("train")[2].share > 0.01


@pytest.mark.slow
def test_the_stages_are_nested_where_laws_and_effects_take_up_parts_of_one_another() -> None:
    """A single trial, without a noise record."""
    trial = recordings({"puncture": {"size": 0.6, "depth_mm": 33.0, "bulge_mm": 2.5}}, seed=2)[:1]
    found = diagnose(BASE, trial, library=Library([effect_named(name) for name in ("viscous", "puncture")], BASE))
    assert nested(found)


def test_the_effects_close_what_the_comparison_of_the_merged_model_says(viscous: Diagnosis) -> None:
    for trial in compare(viscous.model, viscous.recordings, fitted=True).trials:
        stages = viscous.budget.trials[trial.trial]
        assert trial.gap == pytest.approx(stages["effects"], rel=0.01)
        assert trial.without == pytest.approx(stages["parameters"], rel=0.01)
