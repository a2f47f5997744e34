"""Faults 1 to 27 through the guard: each ends in its state, in time, with its cause in the recording."""

import math
from collections.abc import Iterator
from pathlib import Path

import pytest

from needleplan.control.safety import Cause, OperatingState, Order
from needleplan.devices import Source
from needleplan.errors import MotionRefused
from tests.control.faults.rig import Rig
from tests.control.faults.sensors import RUNNING, STARTING, Running, Starting, _biased_under_load
from tests.devices.ndi.bench import plate


@pytest.fixture
def rig(tmp_path: Path) -> Iterator[Rig]:
    rig = Rig(tmp_path / "run.mcap")
    yield rig
    rig.close()


@pytest.mark.parametrize("fault", RUNNING, ids=lambda fault: f"{fault.number:02d} {fault.name}")
def test_while_it_inserts(fault: Running, rig: Rig) -> None:
    rig.begin()
    count = len(rig.stage.wire)
    fault.inject(rig)
    stopped = ("stop",) in rig.stage.wire[count:]
    took_s = 0.0 if stopped else rig.turns_until_stop(0.4)
    first = rig.first_stop()
    if fault.state is OperatingState.ENABLED:
        assert math.isnan(took_s)
        assert rig.guard.state.operating is OperatingState.ENABLED
        assert first is None
        return
    assert first is not None
    assert took_s <= fault.within_s + 1e-9
    assert (first.state, first.causes) == (fault.state, {fault.cause})
    rig.turns(0.2)
    assert Cause.STILL_MOVING not in rig.guard.state.latched
    with pytest.raises(MotionRefused, match="not_enabled"):
        rig.guard.insert(100.0, 5.0)
    told = [each for each in rig.recorded() if each["name"] == "transition" and each["before"] == "ENABLED"]
    assert [(each["state"], each["cause"]) for each in told] == [(fault.state, fault.cause)]
    stops = [each for each in rig.recorded() if each["name"] == "stop"]
    assert fault.cause in stops[0]["cause"]
    assert int(stops[0]["sent_ns"]) in rig.stage.times_ns


def test_24_another_tool_is_doubted_first_and_a_fault_with_the_next_frame(rig: Rig) -> None:
    rig.begin()
    rig.tip.pose = plate
    rig.turns(0.1)
    assert Cause.POSE_JUMPED in rig.guard.state.latched
    told = [(each["before"], each["state"]) for each in rig.recorded() if each["name"] == "transition"]
    assert ("PAUSED", "FAULT") in told


@pytest.mark.parametrize("fault", STARTING, ids=lambda fault: f"{fault.number:02d} {fault.name}")
def test_before_it_inserts(fault: Starting, rig: Rig) -> None:
    fault.inject(rig)
    rig.open()
    rig.turns(0.1)
    assert any(fault.message in str(each) for each in rig.refusals)
    rig.guard.order(Order.HOME)
    with pytest.raises(MotionRefused) as refusal:
        rig.guard.order(Order.ENABLE)
    assert fault.cause in refusal.value.causes
    assert rig.guard.state.operating is OperatingState.DISABLED
    with pytest.raises(MotionRefused):
        rig.guard.insert(10.0, 5.0)
    assert rig.stage.wire == []
    raised = [each for each in rig.recorded() if each["name"] == "raised" and fault.cause in each["cause"]]
    assert any(fault.message in each["text"] for each in raised)


def test_17_a_bias_under_load_is_refused_and_nothing_is_enabled(rig: Rig) -> None:
    _biased_under_load(rig)
    assert rig.force is not None
    rig.trying(Source.FORCE, rig.force.bias)
    assert "under load" in str(rig.refusals[-1])
    assert rig.guard.state.operating is OperatingState.DISABLED
    assert Cause.FORCE_FAULT in rig.guard.state.present
    assert any("under load" in each["text"] for each in rig.recorded())
