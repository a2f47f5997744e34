"""Faults 1 to 27: how each is injected into the bytes, and where it must end."""

from collections.abc import Callable
from dataclasses import dataclass, replace

from needleplan.control.safety import Cause, OperatingState
from needleplan.devices.ati import NetFt
from needleplan.devices.ati.rdt import RdtCommand, encode_request
from needleplan.devices.ndi import SimulatedTool
from needleplan.devices.ndi.frames import NdiVisibility
from tests.control.faults.rig import Rig
from tests.devices.ndi.bench import plate

__all__ = ["RUNNING", "STARTING", "Running", "Starting"]

D, E, P, F = OperatingState.DISABLED, OperatingState.ENABLED, OperatingState.PAUSED, OperatingState.FAULT


@dataclass(frozen=True)
class Running:
    """A fault in the middle of an insertion: into which state it leads, for which cause, within what time."""

    number: int
    name: str
    inject: Callable[[Rig], None]
    state: OperatingState = E
    cause: Cause | None = None
    within_s: float = 0.0
    """From the fault to the stop on the wire, at most."""


@dataclass(frozen=True)
class Starting:
    """A fault before the insertion: nothing is enabled, for these causes, and the message says why."""

    number: int
    name: str
    inject: Callable[[Rig], None]
    cause: Cause
    message: str


def _set(what: str, value: object) -> Callable[[Rig], None]:
    """Return what sets an attribute, as `box.faults.silent`."""
    *path, last = what.split(".")

    def inject(rig: Rig) -> None:
        owner: object = rig
        for name in path:
            owner = getattr(owner, name)
        setattr(owner, last, value)

    return inject


def _step(force_n: float) -> Callable[[Rig], None]:
    return _set("wrench.extra_n", force_n)


def _garbage(rig: Rig) -> None:
    rig.box.faults.instead = [b"", b"short", b"x" * 35, b"long" * 40, b"\xff" * 36]


def _only_garbage(rig: Rig) -> None:
    step = rig.box.step
    rig.box.step = lambda time_s: [b"\xff" * len(each) for each in step(time_s)]  # type: ignore[method-assign]


def _stolen(rig: Rig) -> None:
    rig.box.request(encode_request(RdtCommand.START), ("another", 1))


def _about_to_wrap(rig: Rig) -> None:
    assert isinstance(rig.force, NetFt)
    watch = rig.force._watch
    assert watch._last is not None
    watch._last = replace(watch._last, rdt_sequence=2**32 - 4)
    rig.box.rdt_sequence = 2**32 - 4


def _started_again(rig: Rig) -> None:
    rig.box_link.send(encode_request(RdtCommand.START))


def _foreign_bias(rig: Rig) -> None:
    rig.box.request(encode_request(RdtCommand.BIAS), ("another", 1))


def _foreign_bias_on_page(rig: Rig) -> None:
    """Nothing is seen in the stream; the page is read every half second."""
    assert isinstance(rig.force, NetFt)
    rig.force._bias_watch.see = lambda _: False  # type: ignore[method-assign]
    _foreign_bias(rig)
    rig.check_force()


def _stuck(rig: Rig) -> None:
    rig.wrench.noise_n = 0.0
    rig.wrench._random.gauss = lambda *_: 0.0  # type: ignore[method-assign]


def _other_units(rig: Rig) -> None:
    rig.box.settings.force_unit = "lbf"
    rig.check_force()


def _frame_back(rig: Rig) -> None:
    rig.aurora.first_frame = -5


def _skipped(rig: Rig) -> None:
    rig.aurora.first_frame += 3


def _long_quaternion(rig: Rig) -> None:
    rig.tip.pose = lambda time_s: ((1.2, 0, 0, 0), (10 + 2 * time_s, -20, -150))


def _flipped(rig: Rig) -> None:
    before = rig.tip.pose
    rig.tip.pose = lambda time_s: (tuple(-each for each in before(time_s)[0]), before(time_s)[1])  # type: ignore[return-value]


def _swapped(rig: Rig) -> None:
    rig.tip.pose = plate


def _plugged(rig: Rig) -> None:
    rig.aurora.faults.system_status = 0x40


def _reset(rig: Rig) -> None:
    rig.aurora_link.say(rig.aurora.reset())


def _unplug(rig: Rig) -> None:
    rig.aurora_link.unplug()


def _three_frames_missing(rig: Rig) -> None:
    rig.tip.visibility = NdiVisibility.MISSING
    rig.turns(0.05)
    rig.tip.visibility = NdiVisibility.VALID


def _a_moment_of_saturation(rig: Rig) -> None:
    rig.box.faults.status = 0x8002_0000
    rig.turns(0.02)
    rig.box.faults.status = 0


def _rebooted(rig: Rig) -> None:
    client = rig.box.client
    rig.box.reboot()
    rig.box.client = client


RUNNING = [
    Running(2, "the stream stops", _set("box.faults.silent", True), F, Cause.FORCE_STALE, 0.05),
    Running(3, "three datagrams are lost", _set("box.faults.lose", 3)),
    Running(3, "twenty datagrams are lost", _set("box.faults.lose", 20), F, Cause.FORCE_STALE, 0.05),
    Running(4, "duplicates", _set("box.faults.duplicate", 10)),
    Running(5, "reordered", _set("box.faults.reorder", 2)),
    Running(6, "rdt_sequence wraps", _about_to_wrap),
    Running(7, "ft_sequence stands still", _set("box.faults.freeze", True), F, Cause.FORCE_SUSPECT, 0.05),
    Running(8, "the box restarts, and is silent", lambda rig: rig.box.reboot(), F, Cause.FORCE_STALE, 0.05),
    Running(8, "the box restarts, and sends", _rebooted, F, Cause.FORCE_FAULT, 0.01),
    Running(9, "some garbage", _garbage),
    Running(9, "nothing but garbage", _only_garbage, F, Cause.FORCE_STALE, 0.05),
    Running(11, "saturation", _set("box.faults.status", 0x8002_0000), F, Cause.FORCE_SUSPECT, 0.05),
    Running(11, "saturation for 20 ms", _a_moment_of_saturation),
    Running(12, "a threshold latches", lambda rig: rig.box.exceed_threshold(), F, Cause.FORCE_SUSPECT, 0.05),
    Running(13, "another status", _set("box.faults.status", 0x8800_0000), F, Cause.FORCE_FAULT, 0.01),
    Running(14, "units changed meanwhile", _other_units, F, Cause.FORCE_FAULT, 0.01),
    Running(15, "another client takes the stream", _stolen, F, Cause.FORCE_STALE, 0.05),
    Running(15, "another client starts our stream again", _started_again, F, Cause.FORCE_FAULT, 0.01),
    Running(17, "another client biases the loaded sensor", _foreign_bias, F, Cause.FORCE_FAULT, 0.03),
    Running(17, "another client biases the unloaded sensor", _foreign_bias_on_page, F, Cause.FORCE_FAULT, 0.01),
    Running(16, "the same counts for ever", _stuck, F, Cause.FORCE_SUSPECT, 0.31),
    Running(16, "a step of 12 N", _step(12.0), F, Cause.FORCE_EXCEEDED, 0.01),
    Running(16, "counts at their end", _step(2.0**40), F, Cause.FORCE_EXCEEDED, 0.01),
    Running(18, "a damaged reply", _set("aurora.faults.damage", 1)),
    Running(18, "three damaged replies", _set("aurora.faults.damage", 3), P, Cause.POSE_STALE, 0.05),
    Running(18, "damage without end", _set("aurora.faults.damage", 10**9), P, Cause.POSE_STALE, 0.05),
    Running(19, "a reply cut short", _set("aurora.faults.cut", 1), P, Cause.POSE_STALE, 0.05),
    Running(20, "a transient error", _set("aurora.faults.error", 0x04)),
    Running(20, "an error", _set("aurora.faults.error", 0x0C), F, Cause.POSE_FAULT, 0.04),
    Running(21, "not seen for 50 ms", _three_frames_missing, P, Cause.POSE_UNSEEN, 0.05),
    Running(21, "MISSING", _set("tip.visibility", NdiVisibility.MISSING), P, Cause.POSE_UNSEEN, 0.05),
    Running(21, "DISABLED", _set("tip.visibility", NdiVisibility.DISABLED), F, Cause.POSE_FAULT, 0.04),
    Running(21, "gone from the reply", _set("tip.enabled", False), F, Cause.POSE_FAULT, 0.04),
    Running(22, "out of the volume", _set("tip.port_bits", 0x40), P, Cause.POSE_SUSPECT, 0.05),
    Running(22, "a bad fit", _set("tip.error_mm", 2.5), P, Cause.POSE_SUSPECT, 0.05),
    Running(23, "the same frame for ever", _set("aurora.faults.freeze", True), P, Cause.POSE_STALE, 0.05),
    Running(23, "three frames skipped", _skipped),
    Running(23, "the frame number goes back", _frame_back, F, Cause.POSE_FAULT, 0.04),
    Running(24, "a quaternion of length 1.2", _long_quaternion, P, Cause.POSE_SUSPECT, 0.05),
    Running(24, "q becomes -q", _flipped),
    Running(24, "the handle with another tool", _swapped, P, Cause.POSE_SUSPECT, 0.05),
    Running(24, "the device says that tools were plugged", _plugged, F, Cause.POSE_FAULT, 0.04),
    Running(25, "RESET", _reset, F, Cause.POSE_FAULT, 0.04),
    Running(26, "replies take 5 s", _set("aurora.faults.delay_s", 5.0), P, Cause.POSE_STALE, 0.05),
    Running(26, "no reply", _set("aurora.faults.mute", True), P, Cause.POSE_STALE, 0.05),
    Running(27, "the cable is out", _unplug, F, Cause.POSE_FAULT, 0.01),
]


def _biased_under_load(rig: Rig) -> None:
    sensor = rig.open_force()
    sensor.bias()
    rig.wrench.extra_n = 3.0
    sensor.read(0.05)


def _other_speed(rig: Rig) -> None:
    rig.aurora.reset()
    rig.aurora.faults.mute = True


def _no_tool(rig: Rig) -> None:
    rig.aurora.tools = [SimulatedTool("99999999", plate)]


STARTING = [
    Starting(1, "no reply", _set("box.faults.silent", True), Cause.FORCE_FAULT, "no record within"),
    Starting(14, "a unit nobody knows", _set("box.settings.force_unit", "stone"), Cause.FORCE_FAULT, "stone"),
    Starting(14, "no counts per force", _set("box.settings.counts_per_force", 0.0), Cause.FORCE_FAULT, "cfgcpf"),
    Starting(20, "another tool", _no_tool, Cause.POSE_FAULT, "99999999"),
    Starting(25, "the speeds differ", _other_speed, Cause.POSE_FAULT, "INIT"),
]
