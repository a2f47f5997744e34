"""The claims of a plan beside recorded insertions, which are drawn here from the equations of the claims."""

from __future__ import annotations

import json
import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import binomtest

import needleplan as npl
from needleplan.cli import main
from needleplan.diagnosis.plan_claims import PlanClaim, PlanComparison, compare_plan
from needleplan.errors import DataError
from needleplan.recording import EVENT, Recorder, Recording, Session
from tests.control.scenes import small_table

STEPS, PREDICTED, ERROR_RAD = 14, 0.9, 0.01


def recorded(
    folder: Path,
    ends: Sequence[str],
    *,
    curvature: float = 1.0,
    noise: float = 1.0,
    aside_mm: float = 0.0,
    seed: int = 0,
) -> list[Recording]:
    """Write insertions whose curvature and noise are multiples of those of the plan, and read them."""
    scenario, random, found = small_table().scenario, np.random.default_rng(seed), []
    motion, step_mm = scenario.motion, scenario.step_mm
    each_rad = motion.noise_step_rad * np.sqrt(2 * sum(k**2 * p for k, p in enumerate(motion.tip_noise)))
    for number, end in enumerate(ends):
        bevels, turns = np.ones(STEPS), random.random(STEPS) < 0.3
        headings = np.zeros(STEPS)
        for step in range(STEPS):
            bevels[step] = bevels[step - 1] * (-1 if step and turns[step - 1] else 1)
            if step + 1 < STEPS:
                after = bevels[step] * (-1 if turns[step] else 1)
                kick = noise * each_rad * random.standard_normal()
                headings[step + 1] = (
                    headings[step] + curvature * after * step_mm / scenario.needle.curvature_radius_mm + kick
                )
        read = headings + ERROR_RAD * random.standard_normal(STEPS)
        path = folder / f"run {number}.mcap"
        with Recorder(path, Session(digests={"table": small_table().digest})) as recorder:
            decisions, events = recorder.channel("/decision", EVENT), recorder.channel("/event", EVENT)
            for step in range(STEPS):
                decisions.put(recorder.session.monotonic_ns + step, {
                    "success": PREDICTED, "path_mm": step * step_mm, "turn": bool(turns[step]),
                    "action": "rotate" if turns[step] else "insert", "pose": [20.0, 20.0, read[step], bevels[step]],
                    "tip": {"z_mm": aside_mm + 0.1 * random.standard_normal(), "heading_sd_rad": ERROR_RAD},
                })  # fmt: skip
            events.put(recorder.session.monotonic_ns + STEPS, {"name": "end", "cause": end})
        found.append(Recording.read(path))
    return found


def claim(found: PlanComparison, name: str) -> PlanClaim:
    return next(each for each in found.claims if each.name == name)


def test_a_plan_whose_claims_are_true_is_not_doubted(tmp_path: Path) -> None:
    found = compare_plan(small_table(), recorded(tmp_path, ["target"] * 7 + ["missed"]))
    assert found.ok
    assert [each.name for each in found.claims] == [
        "success", "curvature", "tip noise of a step", "distance from the plane",
    ]  # fmt: skip
    assert all(each.low <= each.planned <= each.high for each in found.claims)
    assert claim(found, "curvature").planned == 1 / 40
    assert found.remarks == (
        "the success of the plan assumes that each decision knows the pose; the standard deviation of the heading was "
        "0.57 deg",
    )


@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("curvature", {"curvature": 1.5}),
        ("tip noise of a step", {"noise": 2.0}),
        ("tip noise of a step", {"noise": 0.4}),
        ("distance from the plane", {"aside_mm": 0.8}),
    ],
)
def test_each_false_claim_is_found_alone(tmp_path: Path, name: str, changes: dict[str, float]) -> None:
    found = compare_plan(small_table(), recorded(tmp_path, ["target"] * 8, seed=3, **changes))
    assert [each.name for each in found.claims if not each.holds] == [name]
    assert not claim(found, name).low <= claim(found, name).planned <= claim(found, name).high


def test_the_chance_of_a_number_of_successes_is_that_of_the_binomial_test(tmp_path: Path) -> None:
    found = compare_plan(small_table(), recorded(tmp_path, ["target"] * 3 + ["missed", "unreachable", "collision"]))
    success, ours = claim(found, "success"), binomtest(3, 6, PREDICTED)
    assert success.p_value == pytest.approx(ours.pvalue)
    assert (success.low, success.high) == pytest.approx(tuple(ours.proportion_ci(0.95)))
    assert (success.measured, success.holds) == (0.5, ours.pvalue >= 0.01)


def test_the_success_of_a_tip_that_is_known_up_to_a_coil_is_a_claim_of_its_own(tmp_path: Path) -> None:
    runs = recorded(tmp_path, ["target"] * 5 + ["missed"] * 3)
    known, late = compare_plan(small_table(), runs).claims[0], compare_plan(small_table(), runs, 10.0).claims[1]
    assert late.name == "success, coil 10 mm behind"
    assert late.planned < known.planned - 0.05
    assert (late.measured, late.low, late.high) == (known.measured, known.low, known.high)


def test_what_a_person_or_a_fault_ended_does_not_judge_the_plan(tmp_path: Path) -> None:
    found = compare_plan(small_table(), recorded(tmp_path, ["target", "stopped", "fault"]))
    assert found.runs == 1
    assert found.remarks[:2] == (
        "run 1.mcap is left out: it ended as stopped", "run 2.mcap is left out: it ended as fault",
    )  # fmt: skip


def test_a_recording_of_another_table_is_refused(tmp_path: Path) -> None:
    other = npl.plan(replace(small_table().scenario, title="another"))
    with pytest.raises(DataError, match=r"run 0\.mcap: is no insertion with this table"):
        compare_plan(other, recorded(tmp_path, ["target"]))


def test_claims_that_nothing_judges_do_not_hold(tmp_path: Path) -> None:
    found = compare_plan(small_table(), recorded(tmp_path, ["stopped"]))
    assert (found.claims, found.ok) == ((), False)
    assert found.remarks[1] == "curvature and tip noise are not judged: no step of these insertions was to bend"


def test_an_insertion_counts_once(tmp_path: Path) -> None:
    (one,) = recorded(tmp_path, ["target"])
    copy = Path(shutil.copy(one.path, tmp_path / "copy.mcap"))
    with pytest.raises(DataError, match=r"copy\.mcap: is the insertion of run 0\.mcap once more"):
        compare_plan(small_table(), [one, Recording.read(copy)])


def test_the_command_prints_the_claims_and_says_by_its_code_whether_they_hold(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    small_table().write(tmp_path / "table.h5")
    files = [str(each.path) for each in recorded(tmp_path, ["target"] * 4 + ["missed"] * 4)]
    assert main(["compare", str(tmp_path / "table.h5"), *files]) == 1
    printed = capsys.readouterr().out
    assert "claims of the plan beside 8 insertions" in printed
    assert "does not hold" in printed
    assert main(["compare", str(tmp_path / "table.h5"), *files, "--json"]) == 1
    assert [each["holds"] for each in json.loads(capsys.readouterr().out)["claims"]] == [False, True, True, True]
    assert main(["diagnose", str(tmp_path / "table.h5"), files[0], "-o", str(tmp_path / "found")]) == 2
    assert "is a policy table; `needleplan compare" in capsys.readouterr().err
    for option in (["--fit"], ["--surface", "0"], ["--accept-units"]):
        assert main(["compare", str(tmp_path / "table.h5"), files[0], *option]) == 2
        refused = capsys.readouterr().err
        assert refused.startswith(f"needleplan: {option[0]}")
        assert "is for models" in refused


@pytest.mark.study
def test_intervals_of_curvature_and_noise_hold(tmp_path: Path) -> None:
    held: list[list[bool]] = []
    for seed in range(150):
        folder = tmp_path / str(seed)
        folder.mkdir()
        found = compare_plan(small_table(), recorded(folder, ["target"] * 3, seed=seed))
        held.append([each.low <= each.planned <= each.high for each in found.claims[1:3]])
    assert (np.mean(held, axis=0) > 0.9).all()
