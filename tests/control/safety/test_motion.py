"""Whether the stage does what it was told: the faults that only its samples show."""

from collections.abc import Callable
from dataclasses import replace

import pytest

from needleplan.control.safety import Cause, GuardedStage, OperatingState, Order, Owner, SafetyLimits
from needleplan.control.safety._motion import MotionWatch
from needleplan.devices import StageSample, Stamp
from needleplan.errors import MotionRefused
from tests.control.safety.bench import Bench

STEP_S = 0.005


def moving(bench: Bench, velocity_mm_s: float, seconds: float, until: Callable[[], bool] = lambda: False) -> None:
    """Let the stage move for a while."""
    bench.stage.moving, bench.stage.velocity_mm_s = True, velocity_mm_s
    for _ in range(round(seconds / STEP_S)):
        bench.stage.depth_mm += velocity_mm_s * STEP_S
        bench.turn()
        if until():
            return


def stopped(bench: Bench) -> bool:
    return bench.stage.wire[-1:] == [("stop",)]


def ended(bench: Bench, cause: Cause) -> None:
    assert stopped(bench)
    assert cause in bench.causes
    assert cause in bench.guard.state.latched


def test_an_honest_stage_may_go_in_and_out_and_turn(bench: Bench, guard: GuardedStage) -> None:
    guard.insert(20.0, 5.0)
    moving(bench, 5.0, 4.0)
    guard.insert(10.0, 20.0)
    moving(bench, 5.0, 0.1)  # it takes a moment to turn round
    moving(bench, -19.0, 0.55)
    bench.stage.moving, bench.stage.velocity_mm_s = False, 0.0
    guard.rotate(3.0, 6.0)
    for _ in range(100):
        bench.stage.roll_rad += 0.03
        bench.turn()
    bench.turns(2.0)
    assert guard.state.operating is OperatingState.ENABLED


def test_the_wrong_way(bench: Bench) -> None:
    bench.enabled().insert(20.0, 5.0)
    moving(bench, -5.0, 1.0, lambda: stopped(bench))
    ended(bench, Cause.WRONG_WAY)
    assert bench.stage.depth_mm > -1.5


def test_beyond_its_goal(bench: Bench) -> None:
    bench.enabled().insert(2.0, 5.0)
    moving(bench, 5.0, 1.0, lambda: stopped(bench))
    ended(bench, Cause.WRONG_WAY)
    assert bench.stage.depth_mm < 3.5


@pytest.mark.parametrize("axis", ["depth", "roll"])
def test_no_motion(bench: Bench, guard: GuardedStage, axis: str) -> None:
    if axis == "depth":
        guard.insert(20.0, 5.0)
    else:
        guard.rotate(3.0, 6.0)
    bench.turns(0.45)
    assert not stopped(bench)
    bench.turns(0.1)
    ended(bench, Cause.NO_MOTION)


@pytest.mark.parametrize("axis", ["depth", "roll"])
@pytest.mark.parametrize(("velocity", "soon_s"), [(5.0, 0.11), (0.5, 0.21)])
def test_an_axis_that_stands_still_on_its_way(
    bench: Bench, guard: GuardedStage, axis: str, velocity: float, soon_s: float
) -> None:
    """With `velocity` of 0.5, an axis needs 0.2 s for 0.1 mm, and the roll 0.1 s for 0.05 rad."""
    (guard.insert if axis == "depth" else guard.rotate)(20.0, velocity)
    bench.stage.moving = True
    name = f"{axis}_{'mm' if axis == 'depth' else 'rad'}"
    for _ in range(200):
        setattr(bench.stage, name, getattr(bench.stage, name) + velocity * STEP_S)
        bench.turn()
    assert not stopped(bench)
    bench.turns(soon_s / 2 - 0.01)
    assert not stopped(bench)
    bench.turns(soon_s / 2 + 0.015)
    ended(bench, Cause.NO_MOTION)
    assert bench.causes & {Cause.WRONG_WAY, Cause.STILL_MOVING} == set()


def test_an_axis_may_be_slow_and_may_stand_at_its_goal() -> None:
    bench = Bench()
    bench.enabled().insert(2.0, 5.0)
    moving(bench, 0.6, 1.0)  # a little more than a tenth of what was commanded
    moving(bench, 5.0, 0.2)
    assert bench.stage.depth_mm == pytest.approx(1.6)
    bench.turns(2.0)  # nearer than the tolerance
    assert not stopped(bench)
    bench = Bench()
    bench.enabled().insert(20.0, 5.0)
    moving(bench, 5.0, 1.0)
    moving(bench, 0.4, 0.15, lambda: stopped(bench))
    ended(bench, Cause.NO_MOTION)


@pytest.mark.parametrize("speed", [-5.0, -1.0])
def test_an_axis_that_goes_back_on_its_way(bench: Bench, speed: float) -> None:
    """An encoder that counts backwards is noticed after the tolerance, not only behind the start of the motion."""
    bench.enabled().insert(20.0, 5.0)
    moving(bench, 5.0, 2.0)
    moving(bench, speed, 2.0, lambda: stopped(bench))
    ended(bench, Cause.WRONG_WAY)
    assert bench.stage.depth_mm > 9.4
    assert bench.causes & {Cause.NO_MOTION} == set()


def test_an_axis_that_goes_back_from_the_start_is_noticed_after_the_tolerance(
    bench: Bench, guard: GuardedStage
) -> None:
    guard.insert(20.0, 5.0)
    moving(bench, 5.0, 1.0)
    guard.insert(20.0, 5.0)  # it already moves towards the goal, and has nothing to turn round
    moving(bench, -5.0, 0.11, lambda: stopped(bench))
    ended(bench, Cause.WRONG_WAY)


def test_an_axis_that_has_not_yet_shown_the_last_command_may_turn_round(bench: Bench, guard: GuardedStage) -> None:
    guard.insert(20.0, 10.0)
    guard.insert(-20.0, 10.0)
    moving(bench, 10.0, 0.1)
    moving(bench, -10.0, 0.5)
    assert not stopped(bench)
    guard.insert(20.0, 10.0)
    bench.stage.velocity_mm_s = 0.0
    bench.turn()
    assert not stopped(bench)
    moving(bench, -10.0, 0.4, lambda: stopped(bench))
    ended(bench, Cause.WRONG_WAY)
    assert bench.stage.depth_mm > -7.6


def test_an_axis_may_turn_round_before_it_follows_a_command(bench: Bench, guard: GuardedStage) -> None:
    guard.insert(20.0, 5.0)
    moving(bench, 5.0, 2.0)
    guard.insert(5.0, 5.0)
    moving(bench, 5.0, 0.15)  # farther inward than the tolerance
    moving(bench, -5.0, 0.5)
    assert not stopped(bench)
    moving(bench, 5.0, 1.0, lambda: stopped(bench))
    ended(bench, Cause.WRONG_WAY)
    assert bench.stage.depth_mm < 8.9


def test_a_machine_that_pauses_sees_no_axis_stand_still() -> None:
    bench = Bench(stage_age_s=5.0, force_age_s=5.0, pose_age_s=5.0, loop_age_s=5.0)
    bench.enabled().insert(20.0, 5.0)
    moving(bench, 5.0, 1.0)
    bench.stage.depth_mm += 1.5
    bench.turn(0.3)
    assert not stopped(bench)
    bench.turn(0.3)
    ended(bench, Cause.NO_MOTION)


def test_no_motion_is_seen_though_the_command_is_repeated(bench: Bench, guard: GuardedStage) -> None:
    for goal in range(24):
        if stopped(bench):
            break
        guard.insert(20.0 + goal, 5.0)
        bench.turns(0.025)
    ended(bench, Cause.NO_MOTION)


def test_too_fast(bench: Bench) -> None:
    bench.enabled().insert(50.0, 5.0)
    moving(bench, 14.0, 0.1)
    assert not stopped(bench)
    moving(bench, 15.5, 0.01)
    ended(bench, Cause.OVERSPEED)


def test_too_deep() -> None:
    bench = Bench(deepest_mm=10.0)
    bench.stage.depth_mm = 9.0
    guard = bench.enabled()
    guard.insert(10.0, 5.0)
    moving(bench, 5.0, 1.0, lambda: stopped(bench))
    ended(bench, Cause.DEPTH_EXCEEDED)
    assert bench.stage.depth_mm < 10.6
    guard.retract(0.0, 5.0)
    assert not stopped(bench)


@pytest.mark.parametrize("how", ["jump", "restart"])
def test_a_lost_zero_needs_homing(bench: Bench, guard: GuardedStage, how: str) -> None:
    guard.insert(50.0, 5.0)
    bench.turn()
    if how == "jump":
        bench.stage.depth_mm += 2.0
    else:
        bench.stage.number = 0
    bench.turn()
    ended(bench, Cause.STAGE_JUMPED)
    bench.turn()
    guard.order(Order.RESET)
    assert not guard.state.is_homed
    guard.order(Order.HOME)
    guard.order(Order.ENABLE)


@pytest.mark.parametrize("order", [None, Order.PAUSE, Order.DISABLE])
def test_moving_without_being_told(bench: Bench, order: Order | None) -> None:
    if order is not None:
        guard = bench.enabled()
        guard.insert(50.0, 5.0)
        guard.order(order)
        moving(bench, 5.0, 0.12)
        assert Cause.STILL_MOVING not in bench.causes, "it may go on for its braking distance, 0.625 mm"
        moving(bench, 5.0, 0.02)
        assert Cause.STILL_MOVING in bench.causes
    moving(bench, 5.0, 0.6, lambda: bench.guard.state.operating is OperatingState.FAULT)
    ended(bench, Cause.STILL_MOVING)


def test_drifting_at_rest(bench: Bench) -> None:
    bench.enabled()
    bench.turns(0.1)
    for _ in range(200):
        bench.stage.depth_mm += 0.004
        bench.turn()
    ended(bench, Cause.STILL_MOVING)


@pytest.mark.parametrize("told", ["nothing", "insert", "rotate"])
def test_the_measured_roll_is_watched_like_the_depth(bench: Bench, guard: GuardedStage, told: str) -> None:
    bench.turns(0.6)
    if told == "insert":
        guard.insert(20.0, 5.0)
    if told == "rotate":
        guard.rotate(1.0, 6.0)
    for _ in range(40):
        bench.stage.roll_rad -= 0.05
        bench.stage.moving = told != "nothing"
        bench.turn()
        if stopped(bench):
            break
    ended(bench, Cause.STILL_MOVING if told == "nothing" else Cause.WRONG_WAY)
    assert abs(bench.stage.roll_rad) < (1.3 if told == "rotate" else 0.3)


@pytest.mark.parametrize("jump", [1000.0, -1000.0, 2.0])
def test_a_roll_that_jumps_without_a_command_is_a_fault(bench: Bench, guard: GuardedStage, jump: float) -> None:
    bench.turn()
    bench.stage.roll_rad = jump
    bench.turn()
    ended(bench, Cause.STAGE_JUMPED)
    assert (Cause.ROLL_EXCEEDED in guard.state.latched) == (abs(jump) > 200)
    assert not guard.state.is_homed


@pytest.mark.parametrize(("gap_s", "jumps"), [(None, True), (0.001, True), (0.3, False), (50.0, True)])
def test_after_lost_samples_the_clock_of_the_stage_tells_how_far_it_can_have_moved(
    gap_s: float | None, jumps: bool
) -> None:
    """Samples that waited while this machine was busy arrive together; those in between are lost."""
    times_s = (None, None) if gap_s is None else (7.0, 7.0 + gap_s)
    stamps = [Stamp(10**12 + number, number, device_time_s=time_s) for number, time_s in enumerate(times_s)]
    first = StageSample(stamps[0], 40.0, -20.0, 0.0, True)
    watch = MotionWatch().then(first, SafetyLimits())
    depth_mm = 40.0 - 20.0 * (1.7 if gap_s == 50.0 else 0.3)
    assert watch.then(replace(first, stamp=stamps[1], depth_mm=depth_mm), SafetyLimits()).jumped == jumps


def test_a_roll_at_its_limit_may_be_off_by_the_tolerance() -> None:
    bench = Bench(roll_rad=1.0, following_rad=0.1)
    guard = bench.enabled()
    guard.rotate(1.0, 5.0)
    for roll_rad in (0.2, 0.4, 0.6, 0.8, 1.0, 1.09):
        bench.stage.roll_rad = roll_rad
        bench.turn(0.02)
    assert guard.state.operating is OperatingState.ENABLED
    bench.stage.roll_rad = 1.11
    bench.turn()
    ended(bench, Cause.ROLL_EXCEEDED)


@pytest.mark.parametrize(("rise_n", "within_s", "is_fault"), [(2.6, 0.04, True), (2.4, 0.04, False), (3.9, 0.2, False)])
def test_a_force_that_rises_too_fast(
    bench: Bench, guard: GuardedStage, rise_n: float, within_s: float, is_fault: bool
) -> None:
    guard.insert(20.0, 5.0)
    steps = round(within_s / STEP_S)
    for number in range(1, steps + 1):
        bench.force = {"force_n": (0.0, 0.0, 1.0 + rise_n * number / steps)}
        bench.stage.depth_mm += 5 * STEP_S
        bench.turn()
    assert (Cause.FORCE_RISING in guard.state.latched) == is_fault
    assert stopped(bench) == is_fault
    assert Cause.FORCE_EXCEEDED not in guard.state.latched


def test_a_force_that_falls_fast_is_a_puncture_and_no_fault(bench: Bench) -> None:
    bench.force = {"force_n": (0.0, 0.0, 4.5)}
    guard = bench.enabled()
    bench.turns(0.1)
    bench.force = {"force_n": (0.0, 0.0, 0.5)}
    bench.turns(0.1)
    assert guard.state.operating is OperatingState.ENABLED


def test_a_tip_in_an_obstacle_stops_the_needle_with_the_sample_that_shows_it() -> None:
    bench = Bench(check_tip=lambda x_mm, _: {Cause.IN_OBSTACLE} if x_mm > 11.0 else ())
    guard = bench.enabled()
    guard.insert(20.0, 5.0)
    guard.observe_tip((11.0, 5.0), 0.1)
    assert not stopped(bench)
    guard.observe_tip((11.1, 5.0), 0.1)
    ended(bench, Cause.IN_OBSTACLE)


def test_a_needed_deadman_switch_pauses_when_it_is_released_or_silent() -> None:
    bench = Bench(needs_deadman=True)
    guard = bench.guard
    bench.turn()
    guard.order(Order.HOME)
    with pytest.raises(MotionRefused, match="deadman_released"):
        guard.order(Order.ENABLE)
    guard.observe_deadman(held=True)
    guard.order(Order.ENABLE)
    guard.insert(50.0, 5.0)
    bench.turns(0.195)
    assert not stopped(bench)
    bench.turns(0.01)
    assert stopped(bench)
    assert guard.state.first == {Cause.DEADMAN_RELEASED}
    guard.observe_deadman(held=True)
    guard.order(Order.RESUME, Owner.LOOP)
    bench.rest()
    assert guard.state.operating is OperatingState.ENABLED
    guard.observe_deadman(held=False)
    assert guard.state.operating is OperatingState.PAUSED
    # The switch is not a person's resume.
    guard.observe_deadman(held=True)
    guard.order(Order.PAUSE, "anna")
    with pytest.raises(MotionRefused, match="not_authorized"):
        guard.order(Order.RESUME, Owner.LOOP)
