"""All short sequences of orders, commands and faults: a fault stops a moving insertion, whatever went before."""

from collections.abc import Callable, Hashable
from contextlib import suppress
from dataclasses import replace
from itertools import product
from random import Random

import pytest

from needleplan.control.safety import Cause, GuardedStage, OperatingState, Order, Owner
from needleplan.errors import MotionRefused
from tests.control.safety.bench import Bench

DEPTH_MM, STEP_S = 40.0, 0.005
EXCESSIVE = {"force_n": (0.0, 0.0, 50.0)}
UNSEEN = {"position_mm": (float("nan"),) * 3}


class ObedientBench(Bench):
    """A bench whose stage moves as the last command on its wire says, at once and at constant speed."""

    def __init__(self) -> None:
        super().__init__()
        self.stage.depth_mm = DEPTH_MM
        self.obeyed = 0
        self.goals: dict[str, tuple[float, float]] = {}

    def turn(self, seconds: float = STEP_S) -> None:
        """Let the stage move, and the loop make one turn."""
        self.obey()
        stage = self.stage
        stage.moving, before_mm = bool(self.goals), stage.depth_mm
        for name, (end, speed) in list(self.goals.items()):
            left = end - getattr(stage, name)
            setattr(stage, name, getattr(stage, name) + max(-speed * seconds, min(left, speed * seconds)))
            if abs(left) <= speed * seconds:
                del self.goals[name]
        stage.velocity_mm_s = (stage.depth_mm - before_mm) / seconds
        super().turn(seconds)
        self.obey()

    def wait(self, seconds: float) -> None:
        """Let the loop go on for a while, with the longest turns that no age limit forbids."""
        for _ in range(max(round(seconds / 0.025), 1)):
            self.turn(min(seconds, 0.025))

    def obey(self) -> None:
        """Take the last commands on the wire."""
        for name, *values in self.stage.wire[self.obeyed :]:
            if name == "stop":
                self.goals.clear()
            else:
                self.goals[{"insert": "depth_mm", "rotate": "roll_rad"}[name]] = (values[0], values[1])
        self.obeyed = len(self.stage.wire)

    @property
    def harmful(self) -> set[str]:
        """The axes that move into the tissue, or rotate."""
        return {name for name, (end, _) in self.goals.items() if name == "roll_rad" or end > self.stage.depth_mm}

    def enabled(self) -> GuardedStage:
        """Return the guard, enabled as a person would; the wire is kept, because the stage obeys it."""
        self.turn()
        for order in (Order.HOME, Order.RESET, Order.ENABLE):
            self.guard.order(order, "anna")
        return self.guard


def enable(bench: ObedientBench) -> None:
    if bench.guard.state.operating is not OperatingState.DISABLED:
        raise MotionRefused("be enabled twice", ())
    for order in (Order.RESET, Order.HOME, Order.ENABLE):
        bench.guard.order(order, "anna")


def ordered(order: Order, by: str | Owner = "anna") -> Callable[[ObedientBench], object]:
    return lambda bench: bench.guard.order(order, by)


def seen_once(what: str, values: dict[str, object]) -> Callable[[ObedientBench], None]:
    def see(bench: ObedientBench) -> None:
        setattr(bench, what, values)
        bench.wait(0.05)
        setattr(bench, what, {})

    return see


ACTIONS: dict[str, Callable[[ObedientBench], object]] = {
    "insert": lambda bench: bench.guard.insert(bench.stage.depth_mm + 30, 5.0),
    "withdraw": lambda bench: bench.guard.insert(bench.stage.depth_mm - 20, 5.0),
    "rotate": lambda bench: bench.guard.rotate(bench.stage.roll_rad + 20, 5.0),
    "retract": lambda bench: bench.guard.retract(bench.stage.depth_mm - 10, 20.0, "anna"),
    "stop": lambda bench: bench.guard.stop(),
    "pause": ordered(Order.PAUSE),
    "resume": ordered(Order.RESUME),
    "continue": ordered(Order.RESUME, Owner.LOOP),
    "disable": ordered(Order.DISABLE),
    "loop stops": ordered(Order.STOP, Owner.LOOP),
    "enable": enable,
    "force": seen_once("force", EXCESSIVE),
    "unseen": seen_once("pose", UNSEEN),
    "wait": lambda bench: bench.wait(0.75),
}


def after(names: tuple[str, ...]) -> ObedientBench | None:
    """Return the bench after a sequence of actions; None if its last action was refused, and so changed nothing."""
    bench = ObedientBench()
    bench.enabled()
    for name in names:
        try:
            ACTIONS[name](bench)
        except MotionRefused:
            return None
        bench.wait(0.01)
    return bench


def state_of(bench: ObedientBench) -> Hashable:
    """Return what decides over the future of guard and stage, without times and places."""
    guard, motion = bench.guard, bench.guard._monitor.motion
    goals = [goal and (goal.end > goal.begin, goal.end > bench.stage.depth_mm) for goal in (motion.depth, motion.roll)]
    flags = {name: each for name, each in vars(guard).items() if isinstance(each, bool)}
    late = (bench.clock.now_ns() - motion.stopped_ns) * 1e-9 > guard.limits.motion_s
    return (
        replace(guard.state, since_ns=0), *goals, late, motion.rest_mm is None, motion.jumped, tuple(flags.items()),
        guard._wire.is_busy, frozenset(bench.goals), frozenset(bench.harmful),
    )  # fmt: skip


def mistake_of(bench: ObedientBench) -> str:
    """Return what is wrong in a state, after a force above its limit is seen there; empty if nothing is."""
    operating, moves = bench.guard.state.operating, bench.harmful
    if moves and operating is not OperatingState.ENABLED:
        return f"moves in {operating}"
    bench.force = EXCESSIVE
    bench.turn()
    if bench.harmful:
        return "the force does not stop it" if moves else "moves by itself"
    return "the force is not latched" if moves and Cause.FORCE_EXCEEDED not in bench.guard.state.latched else ""


def explored(longest: int, *, merge: bool = True) -> tuple[list[int], dict[tuple[str, ...], str]]:
    """Return the numbers of states after at most 1 to `longest` actions, and what is wrong after which actions.

    With `merge`, sequences that lead to the same state are continued once.
    """
    states: set[Hashable] = set()
    found: dict[tuple[str, ...], str] = {}
    ends: list[tuple[str, ...]] = [()]
    counts: list[int] = []
    for _ in range(longest):
        begun, ends = ends, []
        for names in ((*names, name) for names in begun for name in ACTIONS):
            bench = after(names)
            if bench is None:
                continue
            state = state_of(bench) if merge else names
            if state not in states:
                states.add(state)
                ends.append(names)
                if mistake := mistake_of(bench):
                    found[names] = mistake
        counts.append(len(states))
    return counts, found


@pytest.mark.slow
def test_in_every_state_a_force_stops_what_moves_by_order_of_the_loop() -> None:
    counts, found = explored(8)
    assert found == {}
    assert counts[5] == counts[7] > 100  # there are no other states


@pytest.mark.study
def test_after_every_single_sequence_too() -> None:
    counts, found = explored(3, merge=False)
    assert counts[-1] > 500
    assert found == {}


@pytest.mark.slow
@pytest.mark.parametrize(
    "seed", [*range(60), *(pytest.param(seed, marks=pytest.mark.study) for seed in range(60, 300))]
)
def test_after_long_random_sequences_too(seed: int) -> None:
    draw, bench = Random(seed), ObedientBench()
    bench.enabled()
    for name in draw.choices(list(ACTIONS), k=8):
        with suppress(MotionRefused):
            ACTIONS[name](bench)
        bench.wait(0.01)
    assert mistake_of(bench) == ""


def test_the_exploration_reaches_every_state_and_every_motion() -> None:
    reached = {(str(bench.guard.state.operating), *sorted(bench.goals))
               for names in product(ACTIONS, repeat=2) if (bench := after(names)) is not None}  # fmt: skip
    assert reached >= {
        ("ENABLED", "depth_mm", "roll_rad"),
        ("PAUSED", "depth_mm"),
        ("DISABLED", "depth_mm"),
        ("PAUSED",),
    }
