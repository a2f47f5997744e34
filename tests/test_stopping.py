"""When a stopped needle rests: by its samples alone."""

import math
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from needleplan.stopping import GAP_S, WINDOW_S, Rest, StopLimits, StopProcedure, limits_at_any_speed

STEP_S = 0.005


def stop(depth_mm: float | None = 10.0, speed_mm_s: float = 5.0, **limits: float) -> StopProcedure:
    """Return a stop at 100 s that has reached the stage at once."""
    procedure = StopProcedure(StopLimits(**limits), 100.0, depth_mm, speed_mm_s)
    procedure.arrived(100.0)
    return procedure


def fed(procedure: StopProcedure, seconds: float, speed_mm_s: float = 0.0, at_s: float = 100.0) -> float:
    """Take in samples of a needle that moves at a speed from 10 mm, and says that it does not; return the last time."""
    steps = round(seconds / STEP_S)
    for step in range(1, steps + 1):
        procedure.see(at_s + step * STEP_S, 10.0 + speed_mm_s * step * STEP_S, 0.0, 1.0)
    return at_s + steps * STEP_S


def test_a_standstill_of_50_ms_is_rest() -> None:
    procedure = stop()
    assert procedure.rest(fed(procedure, 0.05)) is Rest.BRAKES  # the first sample is 5 ms after the stop
    now_s = fed(procedure, 0.005, at_s=100.05)
    assert procedure.rest(now_s) is Rest.RESTS
    assert procedure.stands
    assert procedure.rest(now_s + GAP_S) is Rest.RESTS
    assert procedure.rest(now_s + GAP_S + 0.001) is Rest.BRAKES  # nothing fresh
    assert procedure.rest(now_s + 0.101) is Rest.UNKNOWN


@pytest.mark.parametrize("speed_mm_s", [0.09, 0.1, 0.2, 0.3, 0.4, 0.5, 1.0, 5.0])
def test_a_needle_that_goes_on_at_its_speed_never_rests(speed_mm_s: float) -> None:
    """Clinical speeds begin at 0.4 mm/s: a deaf robot that says it stands is noticed at each of them, and below."""
    known, unknown = stop(speed_mm_s=speed_mm_s), StopProcedure(limits_at_any_speed(), 100.0)
    unknown.arrived(100.0)
    slower = stop(speed_mm_s=8.0)  # it was faster when it was stopped, and creeps on
    seen = set()
    for step in range(1, 400):
        for procedure in (known, unknown, slower):
            procedure.see(100.0 + step * STEP_S, 10.0 + speed_mm_s * step * STEP_S, 0.0, 1.0)
            seen.add(procedure.rest(100.0 + step * STEP_S))
    assert Rest.RESTS not in seen
    assert Rest.MOVES in seen


@pytest.mark.parametrize("speed_rad_s", [0.017, 0.05, 0.07, 0.1, 3.0])
def test_a_needle_that_turns_on_at_its_speed_never_rests(speed_rad_s: float) -> None:
    known = StopProcedure(StopLimits(), 100.0, 10.0, 0.0, speed_rad_s)
    unknown = StopProcedure(limits_at_any_speed(), 100.0)
    seen = set()
    faster = StopProcedure(StopLimits(), 100.0, 10.0, 0.0, 3.0)
    for procedure in (known, unknown, faster):
        procedure.arrived(100.0)
        for step in range(1, 400):
            procedure.see(100.0 + step * STEP_S, 10.0, 0.0, 1.0 + speed_rad_s * step * STEP_S)
            seen.add(procedure.rest(100.0 + step * STEP_S))
    assert Rest.RESTS not in seen
    assert Rest.MOVES in seen


@pytest.mark.parametrize(
    ("speed_mm_s", "window_s"), [(0.0, 0.05), (0.01, 0.05), (0.2, 0.125), (0.5, 0.05), (5.0, 0.05)]
)
def test_the_window_is_longer_after_a_slow_motion(speed_mm_s: float, window_s: float) -> None:
    assert StopLimits().standstill_s(speed_mm_s) == pytest.approx(window_s)
    procedure = stop(speed_mm_s=speed_mm_s)
    assert procedure.rest(fed(procedure, window_s)) is Rest.BRAKES
    assert procedure.rest(fed(procedure, 0.005, at_s=100.0 + window_s)) is Rest.RESTS


@pytest.mark.parametrize(
    ("values", "rests"),
    [
        ({}, True),
        ({"depth_mm": 10.02}, True),
        ({"depth_mm": 10.021}, False),
        ({"depth_mm": 9.979}, False),
        ({"roll_rad": 1.0039}, True),
        ({"roll_rad": 1.0041}, False),
        ({"velocity_mm_s": -1.0}, True),
        ({"velocity_mm_s": -1.01}, False),
        ({"depth_mm": math.nan}, False),
        ({"velocity_mm_s": math.inf}, False),
        ({"roll_rad": math.nan}, False),
    ],
)
def test_one_sample_that_differs(values: dict[str, float], rests: bool) -> None:
    procedure = stop()
    now_s = fed(procedure, 0.25)
    procedure.see(now_s + STEP_S, **{"depth_mm": 10.0, "velocity_mm_s": 0.0, "roll_rad": 1.0} | values)
    assert (procedure.rest(now_s + STEP_S) is Rest.RESTS) == rests


@pytest.mark.parametrize(("noise_mm", "after_s"), [(0.001, 0.055), (0.004, 0.06), (0.01, 0.13), (0.02, 0.255)])
def test_noise_of_the_encoder_is_rest_after_the_time_that_tells_it_from_a_slow_motion(
    noise_mm: float, after_s: float
) -> None:
    procedure, seen_s = stop(), []
    for step in range(1, 80):
        now_s = 100.0 + step * STEP_S
        procedure.see(now_s, 10.0 + noise_mm * (step % 2), 0.0, 1.0)
        if procedure.rest(now_s) is Rest.RESTS:
            seen_s.append(now_s - 100.0)
    assert seen_s[0] == pytest.approx(after_s, abs=0.006)
    assert len(seen_s) == 80 - round(seen_s[0] / STEP_S)  # and from then on


def test_it_counts_from_the_arrival_of_the_stop() -> None:
    procedure = StopProcedure(StopLimits(), 100.0, 10.0, 5.0)
    now_s = fed(procedure, 0.2)
    assert procedure.rest(now_s) is Rest.BRAKES
    procedure.arrived(now_s)
    procedure.arrived(now_s + 10.0)  # only the first arrival counts
    assert procedure.rest(fed(procedure, 0.055, at_s=now_s)) is Rest.RESTS


@pytest.mark.parametrize(("speed_mm_s", "verdict"), [(0.0, Rest.UNKNOWN), (0.8, Rest.MOVES)])
def test_a_stop_that_has_not_reached_the_stage_is_not_confirmed(speed_mm_s: float, verdict: Rest) -> None:
    procedure = StopProcedure(StopLimits(), 100.0, 10.0, 5.0)
    assert procedure.rest(fed(procedure, 0.51, speed_mm_s)) is verdict
    assert not procedure.stands


def test_a_gap_ends_a_standstill() -> None:
    procedure = stop()
    now_s = fed(procedure, 0.05)
    now_s = fed(procedure, 0.05, at_s=now_s + GAP_S)
    assert procedure.rest(now_s) is Rest.BRAKES
    assert procedure.rest(fed(procedure, STEP_S, at_s=now_s)) is Rest.RESTS


@pytest.mark.parametrize("device_step_s", [0.0, 0.004, 0.006])
def test_samples_that_arrive_together_or_repeat_show_no_standstill(device_step_s: float) -> None:
    """The clock of the stage and this one must both see 50 ms."""
    procedure = stop()
    for step in range(12):
        procedure.see(100.001 + STEP_S * step, 10.0, 0.0, 1.0, 7.0 + device_step_s * step)
    assert (procedure.rest(100.001 + STEP_S * 11) is Rest.RESTS) == (device_step_s * 11 >= WINDOW_S)
    together = stop()
    for step in range(50):
        together.see(100.001 + 1e-5 * step, 10.0, 0.0, 1.0, 7.0 + 0.005 * step)
    assert together.rest(100.002) is Rest.BRAKES


@pytest.mark.parametrize(("speed_mm_s", "within_mm"), [(5.0, 0.625), (10.0, 1.0), (20.0, 2.5)])
def test_beyond_its_braking_distance_it_moves(speed_mm_s: float, within_mm: float) -> None:
    assert StopLimits().braking_mm(speed_mm_s) == pytest.approx(within_mm)
    procedure = stop(speed_mm_s=speed_mm_s)
    way_s = within_mm / speed_mm_s
    now_s = fed(procedure, way_s, speed_mm_s)
    assert procedure.rest(now_s) is Rest.BRAKES
    procedure.see(now_s + STEP_S, 10.0 + within_mm + 0.03, 0.0, 1.0)
    assert procedure.rest(now_s + STEP_S) is Rest.MOVES
    assert procedure.moved_mm == pytest.approx(within_mm + 0.03)
    # The emergency stop brings it to rest.
    for step in range(1, 13):
        procedure.see(now_s + STEP_S * (1 + step), 10.0 + within_mm + 0.03, 0.0, 1.0)
    assert procedure.rest(now_s + STEP_S * 13) is Rest.RESTS


def test_a_slow_needle_moves_after_half_a_second() -> None:
    procedure = stop()
    now_s = fed(procedure, 0.5, 0.8)
    assert procedure.rest(now_s) is Rest.BRAKES
    assert procedure.rest(fed(procedure, 0.51, 0.8)) is Rest.MOVES


@pytest.mark.parametrize(("speed_mm_s", "verdict"), [(0.0, Rest.UNKNOWN), (0.7, Rest.MOVES)])
def test_rare_samples_show_a_motion_but_no_rest(speed_mm_s: float, verdict: Rest) -> None:
    """As from a robot whose computer is busy."""
    procedure = stop()
    for step in range(1, 20):
        procedure.see(100.0 + 0.04 * step, 10.0 + 0.04 * step * speed_mm_s, 0.0, 1.0)
        assert procedure.rest(100.0 + 0.04 * step) is (Rest.BRAKES if step * 0.04 <= 0.5 else verdict)


def test_without_depth_and_speed_the_first_samples_give_both() -> None:
    procedure = stop(None, 0.0)
    assert procedure.moved_mm == 0.0
    procedure.see(100.01, 50.0, 20.0, 0.0)
    procedure.see(100.02, 52.4, 20.0, 0.0)
    assert procedure.rest(100.02) is Rest.BRAKES  # 2.5 mm from 20 mm/s
    procedure.see(100.03, 52.6, 0.0, 0.0)
    assert procedure.rest(100.03) is Rest.MOVES


@given(st.lists(st.tuples(st.floats(0.001, 0.04), st.floats(-0.02, 0.02)), min_size=1, max_size=60))
def test_rest_is_what_its_definition_says(steps: list[tuple[float, float]]) -> None:
    """Beside the definition, written for all runs of samples that end now."""
    procedure, now_s, depth_mm = stop(motion_s=100.0), 100.0, 10.0
    samples: list[tuple[float, float]] = []
    for passed_s, moved_mm in steps:
        now_s, depth_mm = now_s + passed_s, depth_mm + moved_mm
        samples.append((now_s, depth_mm))
        procedure.see(now_s, depth_mm, 0.0, 0.0)
    if procedure.rest(now_s) is not Rest.RESTS:
        return  # the procedure may ask for more: it begins anew where the range is left
    run = next(samples[at:] for at in range(len(samples) - 1, -1, -1) if samples[-1][0] - samples[at][0] >= 0.05 - 1e-6)
    depths = [each for _, each in run]
    assert max(depths) - min(depths) <= 0.02 + 1e-9
    assert all(after - before <= 0.03 + 1e-6 for (before, _), (after, _) in pairwise(run))
