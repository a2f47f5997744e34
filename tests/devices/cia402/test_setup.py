from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from needleplan.devices.cia402 import DrivesSetup, InsertionSetup, RollSetup, VelocityUnit
from needleplan.devices.cia402._motor import Motor
from needleplan.errors import ConfigurationError
from tests.devices.cia402.bench import FILE, SETUP, setup_file


def test_a_file_is_read(tmp_path: Path) -> None:
    assert DrivesSetup.read(setup_file(tmp_path)) == SETUP


@pytest.mark.parametrize(
    ("before", "after", "rule"),
    [
        ("needleplan.drives/1", "needleplan.drives/9", "schema"),
        ("gear = 14.0", "gear = 0", "insertion.gear"),
        ("gear = 14.0", "geer = 14.0", "did you mean"),
        ("lead_mm = 2.0", "lead_mm = nan", "insertion.lead_mm"),
        ("node = 2", "node = 1", "roll.node = 1: must differ"),
        ("node = 2", "node = 127", "roll.node"),
        ("[roll]", "[rol]", "roll.node: is missing"),
        ("direction = -1", "direction = 0", "must be 1 or -1"),
        ("counts_per_turn = 4096", "counts_per_turn = 16000000", "32 bits of counts"),
        ("lead_mm = 2.0", "lead_mm = 2.0\nleast_mm = 5.0\nmost_mm = 4.0", "must be less than the largest position"),
        ("lead_mm = 2.0", "lead_mm = 900.0\nfastest_mm_s = 0.1", "counts/s"),
        ('"counts/s"', '"m/s"', "roll.velocity_unit"),
        ("[roll]", "[roll", "is not TOML"),
    ],
)
def test_a_wrong_file_is_refused_with_key_and_rule(tmp_path: Path, before: str, after: str, rule: str) -> None:
    assert before in FILE
    path = setup_file(tmp_path, FILE.replace(before, after, 1))
    with pytest.raises(ConfigurationError, match=rule) as caught:
        DrivesSetup.read(path)
    assert caught.value.source == str(path)


def test_all_mistakes_are_told_at_once(tmp_path: Path) -> None:
    path = setup_file(tmp_path, FILE.replace("14.0", "-1").replace("23.0", "-1"))
    with pytest.raises(ConfigurationError, match="2 mistakes"):
        DrivesSetup.read(path)


def test_a_file_that_is_not_there_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="cannot be read"):
        DrivesSetup.read(tmp_path / "none.toml")


@given(
    st.integers(100, 100_000), st.floats(0.5, 200), st.sampled_from([1, -1]), st.integers(-10_000, 10_000),
    st.sampled_from(VelocityUnit), st.floats(-50, 150), st.floats(0.5, 20),
)  # fmt: skip
def test_counts_and_millimetres_go_both_ways(
    turn: int, gear: float, direction: int, zero: int, unit: VelocityUnit, position: float, velocity: float
) -> None:
    setup = InsertionSetup(
        node=1, counts_per_turn=turn, gear=gear, direction=direction, zero_counts=zero, velocity_unit=unit, lead_mm=2.0
    )
    one_count = abs(1 / setup.counts_per_unit)
    assert setup.position(setup.counts(position)) == pytest.approx(position, abs=0.51 * one_count)
    assert (setup.counts(position + 1) > setup.counts(position)) == (direction > 0)
    speed = setup.speed(velocity)
    one_step = abs(setup.velocity(1))
    assert abs(setup.velocity(speed)) == pytest.approx(velocity, abs=0.51 * one_step)


def test_a_turn_of_the_roll_axis_is_a_turn() -> None:
    roll = RollSetup(node=2, counts_per_turn=1000, gear=10.0)
    assert roll.counts(2 * 3.141592653589793) == 10_000
    assert roll.speed(2 * 3.141592653589793) == 600


@settings(max_examples=30, deadline=None)
@given(st.floats(-40, 40), st.floats(2, 20))
def test_the_simulated_motor_arrives_and_keeps_its_speed(target_mm: float, velocity_mm_s: float) -> None:
    setup = InsertionSetup(node=1, counts_per_turn=4096, gear=14.0, lead_mm=2.0, least_mm=-150.0)
    motor = Motor(setup, 0, 0)
    unit = setup.counts_per_unit
    motor.begin(0, setup.counts(target_mm), velocity_mm_s * unit)
    expected_s = abs(target_mm) / velocity_mm_s + velocity_mm_s / setup.acceleration_mm_s2
    motor.advance(round(min(0.5, expected_s) * 1e9))
    assert abs(motor.speed) <= velocity_mm_s * unit * 1.001
    motor.advance(round((expected_s + 0.1) * 1e9))
    assert motor.arrived
    assert motor.counts == setup.counts(target_mm)
