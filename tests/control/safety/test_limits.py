"""The limits: every one of them is checked, in the constructor and in a file."""

import math
from dataclasses import fields
from pathlib import Path

import pytest

from needleplan.control.safety import GuardedStage, SafetyLimits
from needleplan.errors import SafetyError
from tests.control.safety.bench import Bench

NUMBERS = [each.name for each in fields(SafetyLimits) if not each.name.startswith("workspace")]


@pytest.mark.parametrize("name", NUMBERS)
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, -1e9, 1e9, "5", None, True, [1.0]])
def test_what_is_no_limit_is_refused_by_name(name: str, value: object) -> None:
    with pytest.raises(SafetyError, match=rf"safety\.{name}"):
        SafetyLimits(**{name: value})


@pytest.mark.parametrize("name", ["workspace_x_mm", "workspace_y_mm"])
@pytest.mark.parametrize("value", [[1.0], [5.0, 5.0], [5.0, 1.0], [math.nan, 1.0], "all"])
def test_what_is_no_workspace_is_refused(name: str, value: object) -> None:
    with pytest.raises(SafetyError, match=rf"safety\.{name}"):
        SafetyLimits(**{name: value})


def test_a_range_of_depths_is_not_empty() -> None:
    with pytest.raises(SafetyError, match=r"shallowest_mm = 10: must be less than deepest_mm, 10"):
        SafetyLimits(shallowest_mm=10, deepest_mm=10)


def test_a_file_says_all_its_mistakes_at_once(tmp_path: Path) -> None:
    file = tmp_path / "run.toml"
    file.write_text('other = 1\n[safety]\nforce_n = -1\ndepest_mm = 80\nrun_s = "long"\n')
    with pytest.raises(SafetyError) as error:
        SafetyLimits.read(file)
    assert str(file) in str(error.value)
    assert len(error.value.mistakes) == 3
    assert 'did you mean "deepest_mm"?' in str(error.value)


def test_a_file_is_read(tmp_path: Path) -> None:
    file = tmp_path / "run.toml"
    file.write_text("[safety]\nforce_n = 4\nworkspace_x_mm = [0, 120]\n")
    limits = SafetyLimits.read(file)
    assert limits == SafetyLimits(force_n=4.0, workspace_x_mm=(0.0, 120.0))
    assert isinstance(limits.force_n, float)


@pytest.mark.parametrize(("text", "rule"), [("[safety", "not TOML"), ("a = 1", "is missing"), ("safety = 3", "table")])
def test_a_file_without_limits_is_refused(tmp_path: Path, text: str, rule: str) -> None:
    file = tmp_path / "run.toml"
    file.write_text(text)
    with pytest.raises(SafetyError, match=rule):
        SafetyLimits.read(file)
    with pytest.raises(SafetyError, match="cannot be read"):
        SafetyLimits.read(tmp_path / "no.toml")


def test_limits_that_are_wider_than_the_defaults_are_lax() -> None:
    assert SafetyLimits().lax == ()
    strict = SafetyLimits(force_n=4.0, shallowest_mm=-50.0, deepest_mm=100.0, workspace_x_mm=(0.0, 60.0))
    assert strict.lax == ()
    lax = SafetyLimits(force_n=5.1, shallowest_mm=-100.1, stage_age_s=10.0)
    assert [str(each) for each in lax.lax] == [
        "safety.force_n = 5.1: is laxer than the default, 5",
        "safety.shallowest_mm = -100.1: is laxer than the default, -100",
        "safety.stage_age_s = 10: is laxer than the default, 0.03",
    ]


@pytest.mark.parametrize("reason", ["", " ", "\n"])
def test_lax_limits_need_a_reason_in_python_too(reason: str) -> None:
    stage, lax = Bench().stage, SafetyLimits(force_n=5.1, run_s=901.0)
    with pytest.raises(SafetyError, match="accepted_limits") as error:
        GuardedStage(stage, lax, accepted_limits=reason)
    assert [each.key for each in error.value.mistakes] == ["safety.force_n", "safety.run_s"]


def test_limits_that_are_exchanged_need_a_reason_too_and_nothing_changes_without_it() -> None:
    guard = Bench().guard
    with pytest.raises(SafetyError, match=r"safety\.force_n = 6"):
        guard.exchange_limits(SafetyLimits(force_n=6.0))
    assert guard.limits == SafetyLimits()
    guard.exchange_limits(SafetyLimits(force_n=6.0), "a phantom of wood")
    assert guard.limits.force_n == 6.0


def test_a_refused_guard_leaves_the_stage_free_for_another(bench: Bench) -> None:
    bench.guard.close()
    with pytest.raises(SafetyError):
        GuardedStage(bench.stage, SafetyLimits(force_n=6.0))
    GuardedStage(bench.stage).close()


@pytest.mark.parametrize(("name", "value"), [
    ("force_n", 200.0), ("force_rate_n_s", 2000.0), ("insertion_velocity_mm_s", 1000.0), ("run_s", 86_400.0),
    ("retraction_velocity_mm_s", 101.0), ("rotation_velocity_rad_s", 101.0), ("roll_rad", 201.0), ("deepest_mm", 501.0),
    ("following_mm", 5.1), ("following_rad", 3.1), ("pose_jump_mm", 51.0),
])  # fmt: skip
def test_no_reason_allows_what_no_needle_robot_does(name: str, value: float) -> None:
    with pytest.raises(SafetyError, match=rf"safety\.{name}"):
        SafetyLimits(**{name: value})
