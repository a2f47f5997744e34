"""A lost zero: the stage is told, and no run begins until a person has homed it, also with another guard."""

import pytest

from needleplan.control.safety import Cause, GuardedStage, OperatingState, Order, Owner
from needleplan.errors import DeviceFault, MotionRefused
from tests.control.safety.bench import Bench, NotedStage


class HomedStage(NotedStage):
    """A stage that knows whether it has its zero."""

    knows: bool | None = True

    @property
    def homed(self) -> bool | None:
        return self.knows

    def home(self) -> None:
        self.note("home")
        self.knows = True

    def unhome(self) -> None:
        self.note("unhome")
        self.knows = False


class HomedBench(Bench):
    def __init__(self, knows: bool | None = True) -> None:
        super().__init__()
        self.guard.close()
        stage = HomedStage(self.clock)
        stage.knows = knows
        self.stage = stage
        self.guard = GuardedStage(stage, clock=self.clock, listener=lambda event: self.events.append(event))


def begin_again(bench: Bench, by: str | Owner) -> None:
    bench.turns(0.3)
    bench.guard.order(Order.RESET, "anna")
    bench.guard.order(Order.HOME, by)
    bench.guard.order(Order.ENABLE, Owner.LOOP if isinstance(by, Owner) else by)
    bench.rest()


def test_a_jump_tells_the_stage_after_the_stop_and_a_rerun_needs_a_person() -> None:
    bench = HomedBench()
    bench.enabled()
    bench.stage.depth_mm += 3.0
    bench.turn()
    assert bench.guard.state.latched == {Cause.STAGE_JUMPED}
    assert [name for name, *_ in bench.stage.wire][:2] == ["stop", "unhome"]
    assert bench.guard.homed is False
    bench.turn()
    assert [name for name, *_ in bench.stage.wire].count("unhome") == 1
    stage, bench = bench.stage, HomedBench(False)  # a rerun: another guard
    assert isinstance(stage, HomedStage)
    assert stage.knows is False
    with pytest.raises(MotionRefused, match="home: refused: not_homed"):
        begin_again(bench, Owner.LOOP)
    with pytest.raises(MotionRefused, match="enable: refused: not_homed"):
        bench.guard.order(Order.ENABLE, "anna")
    begin_again(bench, "anna")
    assert bench.guard.state.operating is OperatingState.ENABLED
    assert ("home",) in bench.stage.wire


@pytest.mark.parametrize("knows", [True, None])
def test_the_loop_homes_a_stage_that_has_its_zero_or_does_not_tell(knows: bool | None) -> None:
    bench = HomedBench(knows)
    bench.turn()
    begin_again(bench, Owner.LOOP)
    assert bench.guard.state.operating is OperatingState.ENABLED
    assert ("home",) not in bench.stage.wire


def test_a_stage_that_cannot_be_homed_is_not_enabled(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse() -> None:
        raise DeviceFault("home: the robot is in a fault")

    bench = HomedBench(False)
    bench.turn()
    monkeypatch.setattr(bench.stage, "home", refuse)
    with pytest.raises(DeviceFault, match="in a fault"):
        begin_again(bench, "anna")
    assert not bench.guard.state.is_homed
    with pytest.raises(MotionRefused, match="enable: refused: not_homed"):
        bench.guard.order(Order.ENABLE, "anna")


def test_no_stage_is_homed_by_an_order_that_is_refused() -> None:
    bench = HomedBench()
    bench.enabled()
    assert isinstance(bench.stage, HomedStage)
    bench.stage.knows = False
    with pytest.raises(MotionRefused):
        bench.guard.order(Order.HOME, "anna")
    assert bench.stage.wire == []
