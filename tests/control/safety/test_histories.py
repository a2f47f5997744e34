"""Long histories of orders, commands, samples and faults at the real guard: the stage stays within its limits."""

import contextlib
from collections.abc import Callable

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from needleplan.control.safety import Cause, OperatingState, Order, Owner, SafetyEventName
from needleplan.errors import MotionRefused
from tests.control.safety.bench import Bench
from tests.control.safety.test_orders import ObedientBench

LIMITS = {"deepest_mm": 60.0, "shallowest_mm": -20.0, "roll_rad": 20.0}
TOLERANCE_MM, TOLERANCE_RAD = 0.5, 0.2
SOME = st.one_of(st.floats(), st.floats(-80, 80))
SPEEDS = st.one_of(st.floats(), st.floats(0.1, 25))


class LimitedBench(ObedientBench):
    """The obedient bench with narrow limits."""

    def __init__(self) -> None:
        Bench.__init__(self, **LIMITS)
        self.obeyed = 0
        self.goals: dict[str, tuple[float, float]] = {}


class Histories(RuleBasedStateMachine):
    """A person, a loop that gives every order it can, and sensors and a robot that fail."""

    @initialize()
    def begin(self) -> None:
        self.bench = LimitedBench()
        self.bench.enabled()
        self.is_wanted_still = self.is_unexamined = False
        self.checked = 0

    def tried(self, what: Callable[[], object]) -> bool:
        """Do something, and return whether it was not refused."""
        done = False
        with contextlib.suppress(MotionRefused):
            what()
            done = True
        self.bench.obey()
        return done

    @rule(depth_mm=SOME, velocity_mm_s=SPEEDS)
    def insert(self, depth_mm: float, velocity_mm_s: float) -> None:
        self.tried(lambda: self.bench.guard.insert(depth_mm, velocity_mm_s))

    @rule(roll_rad=SOME, velocity_rad_s=SPEEDS)
    def rotate(self, roll_rad: float, velocity_rad_s: float) -> None:
        self.tried(lambda: self.bench.guard.rotate(roll_rad, velocity_rad_s))

    @rule(depth_mm=SOME, velocity_mm_s=SPEEDS)
    def retract(self, depth_mm: float, velocity_mm_s: float) -> None:
        if self.tried(lambda: self.bench.guard.retract(depth_mm, velocity_mm_s, "anna")):
            self.is_wanted_still = True

    @rule(order=st.sampled_from(Order), by=st.sampled_from(["anna", *Owner]))
    def order(self, order: Order, by: str | Owner) -> None:
        done = self.tried(lambda: self.bench.guard.order(order, by))
        if done and by in ("anna", Owner.PERSON):
            if order is Order.RESET:
                self.is_unexamined = False
            if order in (Order.PAUSE, Order.DISABLE, Order.STOP):
                self.is_wanted_still = True
                assert self.bench.goals == {}
            if order in (Order.ENABLE, Order.RESUME):
                self.is_wanted_still = False
        if order is Order.STOP:
            self.is_unexamined = True

    @rule()
    def begin_again(self) -> None:
        for order in (Order.RESET, Order.HOME, Order.ENABLE, Order.RESUME):
            self.order(order, "anna")

    @rule()
    def the_loop_goes_on(self) -> None:
        """The loop does what it can to insert further."""
        for order in (Order.RESET, Order.HOME, Order.ENABLE, Order.RESUME):
            self.order(order, Owner.LOOP)
        self.insert(self.bench.stage.depth_mm + 5.0, 5.0)

    @rule(order=st.sampled_from([Order.PAUSE, Order.DISABLE, Order.STOP]), turns=st.integers(0, 4))
    def a_person_interrupts(self, order: Order, turns: int) -> None:
        """A person stops the needle, and the loop wants to go on."""
        self.begin_again()
        self.order(order, "anna")
        for _ in range(turns):
            self.turn()
        self.the_loop_goes_on()
        self.what_harms_is_enabled_and_wanted()

    @rule(turns=st.integers(1, 150))
    def wait(self, turns: int) -> None:
        for _ in range(turns):
            self.turn()

    @rule(force_n=st.floats(-15, 15))
    def push(self, force_n: float) -> None:
        self.bench.force = {"force_n": (0.0, 0.0, force_n)}
        self.turn()

    @rule(who=st.sets(st.sampled_from(["force", "pose", "stage", "loop"]), max_size=2))
    def fall_silent(self, who: set[str]) -> None:
        self.bench.without = who
        self.wait(12)
        self.bench.without = set()

    @rule(depth_mm=st.floats(-30, 70), roll_rad=st.floats(-30, 30))
    def jump(self, depth_mm: float, roll_rad: float) -> None:
        self.bench.stage.depth_mm, self.bench.stage.roll_rad = depth_mm, roll_rad
        self.turn()

    @rule()
    def lose_the_tip(self) -> None:
        tip, self.bench.tip = self.bench.tip, {}
        self.turn()
        self.bench.tip = tip

    def turn(self) -> None:
        bench = self.bench
        bench.turn()
        state = bench.guard.state
        if state.operating is OperatingState.FAULT:
            self.is_unexamined = True
        if bench.harmful:
            assert not state.present
        forbidden = {Cause.FORCE_EXCEEDED, Cause.DEPTH_EXCEEDED, Cause.ROLL_EXCEEDED, Cause.STAGE_JUMPED}
        if state.present & forbidden:
            assert bench.harmful == set()

    @invariant()
    def what_harms_is_enabled_and_wanted(self) -> None:
        bench = getattr(self, "bench", None)
        if bench is None or not bench.harmful:
            return
        assert bench.guard.state.operating is OperatingState.ENABLED
        assert bench.guard.state.is_homed
        assert not self.is_wanted_still
        assert not self.is_unexamined

    @invariant()
    def every_command_is_within_the_limits(self) -> None:
        bench = getattr(self, "bench", None)
        if bench is None:
            return
        for name, *values in bench.stage.wire[self.checked :]:
            if name == "insert":
                # A needle that lies too deep may be pulled out to a place that is still too deep.
                assert -20 <= values[0] <= max(60.0, bench.stage.depth_mm)
                assert 0 < values[1] <= 20
            if name == "rotate":
                assert abs(values[0]) <= 20
                assert 0 < values[1] <= 12
        self.checked = len(bench.stage.wire)

    @invariant()
    def every_stop_is_told(self) -> None:
        bench = getattr(self, "bench", None)
        if bench is not None:
            told = [each for each in bench.named(SafetyEventName.TRANSITION) if each.before is OperatingState.ENABLED]
            assert len(told) <= len(bench.named(SafetyEventName.STOP))


TestHistories = Histories.TestCase
TestHistories.settings = settings(max_examples=10, stateful_step_count=30, deadline=None)
