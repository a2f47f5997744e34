"""Filters for the relays of `fault_proxy.py`: they delay, drop, damage, replay and forge what devices send."""

import random
import time
from collections.abc import Callable
from dataclasses import replace

from fault_relays import Filter, Relay, Sent
from fault_run import Run

from needleplan.devices.ati.rdt import RdtRecord, decode_records, encode_records
from needleplan.devices.ndi.frames import Frames, ToolFrame, encode_bx, parse_bx
from needleplan.devices.robot.messages import RobotStatus, decode, encode
from needleplan.errors import ProtocolError

Inject = Callable[[Run], object]


def relay_of(name: str) -> Callable[[Run], Relay]:
    return lambda run: getattr(run, name)


def filtered(device: str, make: Callable[[Run], Filter], *, to_device: bool = False) -> Inject:
    side = "to_device" if to_device else "to_client"
    return lambda run: setattr(relay_of(device)(run), side, make(run))


def fresh(make: Callable[[], Inject]) -> Inject:
    """Make a filter with a memory anew for each run."""
    return lambda run: make()(run)


def delayed(seconds: float, growth: float = 0.0) -> Callable[[Run], Filter]:
    """Delay everything by `seconds`, and by `growth` more each second."""

    def make(_: Run) -> Filter:
        begun_s = time.monotonic()
        return lambda data: [(seconds + growth * (time.monotonic() - begun_s), data)]

    return make


def doubled(_: Run) -> Filter:
    return lambda data: [(0.0, data), (0.001, data)]


def swapped(_: Run) -> Filter:
    """Let every second datagram overtake the one before it."""
    held: list[bytes] = []

    def swap(data: bytes) -> Sent:
        if not held:
            held.append(data)
            return []
        return [(0.0, data), (0.0, held.pop())]

    return swap


def lossy(share: float) -> Callable[[Run], Filter]:
    noise = random.Random(1)
    return lambda _: lambda data: [] if noise.random() < share else [(0.0, data)]


def damaged(share: float) -> Callable[[Run], Filter]:
    """Flip one bit in a share of the datagrams."""
    noise = random.Random(1)

    def damage(data: bytes) -> Sent:
        if noise.random() >= share:
            return [(0.0, data)]
        raw = bytearray(data)
        raw[noise.randrange(len(raw))] ^= 1 << noise.randrange(8)
        return [(0.0, bytes(raw))]

    return lambda _: damage


def cut_short(share: float) -> Callable[[Run], Filter]:
    noise = random.Random(1)
    return lambda _: lambda data: [(0.0, data[:-5] if noise.random() < share else data)]


def replayed(_: Run) -> Filter:
    """Send everything again half a second later."""
    return lambda data: [(0.0, data), (0.5, data)]


def interrupted(seconds: float) -> Callable[[Run], Filter]:
    """Drop everything for `seconds`."""

    def make(_: Run) -> Filter:
        end_s = time.monotonic() + seconds
        return lambda data: [] if time.monotonic() < end_s else [(0.0, data)]

    return make


def records(change: Callable[[RdtRecord], RdtRecord]) -> Inject:
    """Change the records of the force sensor."""
    return filtered("force", lambda _: lambda data: [(0.0, encode_records(map(change, decode_records(data))))])


def statuses(make: Callable[[], Callable[[RobotStatus], RobotStatus]]) -> Inject:
    """Change the statuses of the robot, with correct checksums."""

    def changed(_: Run) -> Filter:
        change = make()

        def forge(data: bytes) -> Sent:
            message = decode(data)
            return [(0.0, encode(change(message)) if isinstance(message, RobotStatus) else data)]

        return forge

    return filtered("robot", changed)


def frames(make: Callable[[], Callable[[ToolFrame], ToolFrame]]) -> Inject:
    """Change the frames of the tracker, with correct checksums."""

    def changed(_: Run) -> Filter:
        change = make()

        def forge(data: bytes) -> Sent:
            try:
                found = parse_bx(data)
            except ProtocolError:
                return [(0.0, data)]
            return [(0.0, encode_bx(Frames(tuple(map(change, found.tools)), found.system_status)))]

        return forge

    return filtered("tracker", changed)


def drifting_records(rate: float) -> Inject:
    first: list[int] = []

    def change(record: RdtRecord) -> RdtRecord:
        first.append(record.ft_sequence) if not first else None
        return replace(record, ft_sequence=first[0] + int((record.ft_sequence - first[0]) * rate))

    return records(change)


def drifting_status(rate: float) -> Callable[[], Callable[[RobotStatus], RobotStatus]]:
    def make() -> Callable[[RobotStatus], RobotStatus]:
        first: list[int] = []

        def change(status: RobotStatus) -> RobotStatus:
            first.append(status.head.sent_ns) if not first else None
            sent_ns = first[0] + int((status.head.sent_ns - first[0]) * rate)
            return replace(status, head=replace(status.head, sent_ns=sent_ns))

        return change

    return make


def drifting_frame(rate: float) -> Callable[[], Callable[[ToolFrame], ToolFrame]]:
    def make() -> Callable[[ToolFrame], ToolFrame]:
        first: list[int] = []

        def change(tool: ToolFrame) -> ToolFrame:
            frame = tool.frame or 0
            first.append(frame) if not first else None
            return replace(tool, frame=first[0] + int((frame - first[0]) * rate))

        return change

    return make


def frozen_status() -> Callable[[RobotStatus], RobotStatus]:
    kept: list[RobotStatus] = []

    def change(status: RobotStatus) -> RobotStatus:
        kept.append(status) if not kept else None
        return replace(status, depth_mm=kept[0].depth_mm, velocity_mm_s=0.0, roll_rad=kept[0].roll_rad)

    return change


def backwards_status() -> Callable[[RobotStatus], RobotStatus]:
    kept: list[float] = []

    def change(status: RobotStatus) -> RobotStatus:
        kept.append(status.depth_mm) if not kept else None
        return replace(status, depth_mm=2 * kept[0] - status.depth_mm, velocity_mm_s=-status.velocity_mm_s)

    return change


def frozen_frames() -> Inject:
    kept: list[bytes] = []

    def repeat(data: bytes) -> Sent:
        kept.append(data) if not kept else None
        return [(0.0, kept[0])]

    return filtered("tracker", lambda _: repeat)


def frozen_counts() -> Inject:
    kept: list[RdtRecord] = []

    def change(record: RdtRecord) -> RdtRecord:
        kept.append(record) if not kept else None
        return replace(record, counts=kept[0].counts)

    return records(change)


def restarted_box() -> Inject:
    first: list[RdtRecord] = []

    def change(record: RdtRecord) -> RdtRecord:
        first.append(record) if not first else None
        return replace(
            record, rdt_sequence=record.rdt_sequence - first[0].rdt_sequence + 1,
            ft_sequence=record.ft_sequence - first[0].ft_sequence + 35 + (1 << 31),
        )  # fmt: skip

    return records(change)


def with_fields(**changes: float) -> Callable[[], Callable[[RobotStatus], RobotStatus]]:
    return lambda: lambda status: replace(status, **changes)  # type: ignore[arg-type]


def with_more(**changes: float) -> Callable[[], Callable[[RobotStatus], RobotStatus]]:
    return lambda: (
        lambda status: replace(status, **{name: getattr(status, name) + value for name, value in changes.items()})
    )


def with_counts(axis: int, more: int) -> Callable[[RdtRecord], RdtRecord]:
    def change(record: RdtRecord) -> RdtRecord:
        counts = list(record.counts)
        counts[axis] += more
        return replace(record, counts=tuple(counts))  # type: ignore[arg-type]

    return change


def moved(x_mm: float, z_mm: float = 0.0) -> Callable[[], Callable[[ToolFrame], ToolFrame]]:
    def change(tool: ToolFrame) -> ToolFrame:
        x, y, z = tool.position_mm
        return replace(tool, position_mm=(x + x_mm, y, z + z_mm))

    return lambda: change


def turning() -> Callable[[RobotStatus], RobotStatus]:
    """Let the measured roll turn at 3 rad/s, although no command turns it."""
    begun_s = time.monotonic()
    return lambda status: replace(status, roll_rad=status.roll_rad + 3 * (time.monotonic() - begun_s))
