"""ndicapi, an independent client, is content with our device, and reads the same poses from the same bytes."""

from collections.abc import Iterator

import pytest

from needleplan.devices import VirtualClock
from needleplan.devices.endpoint import PtyEndpoint, TcpEndpoint
from needleplan.devices.ndi import AuroraDevice
from needleplan.devices.ndi.commands import ReplyReader, encode_command
from needleplan.devices.ndi.frames import Frames, NdiVisibility, parse_bx, parse_tx
from tests.devices.ndi.bench import aurora

ndi = pytest.importorskip("ndicapy", reason="the independent client ndicapi is not installed (extra: test)")

TIP, REFERENCE = b"\x0a", b"\x0b"


@pytest.fixture
def device() -> AuroraDevice:
    """An Aurora whose time stands still, so that both clients see the same frame."""
    made = aurora()
    made.clock = VirtualClock()
    return made


@pytest.fixture(params=["tcp", "pty"])
def client(device: AuroraDevice, request: pytest.FixtureRequest) -> Iterator[object]:
    if request.param == "tcp":
        with TcpEndpoint(device) as end:
            opened = ndi.ndiOpenNetwork(end.host, end.port)
            yield opened
            ndi.ndiCloseNetwork(opened)
    else:
        with PtyEndpoint(device) as line:
            opened = ndi.ndiOpen(line.path)
            yield opened
            ndi.ndiClose(opened)


def start(client: object) -> None:
    for command in ("INIT:", "PHSR:02", "PINIT:0A", "PINIT:0B", "PHSR:03", "PENA:0AD", "PENA:0BD", "TSTART:"):
        ndi.ndiCommand(client, command)
        assert ndi.ndiGetError(client) == 0, command


def ours(device: AuroraDevice, name: str) -> Frames:
    """What our parsers make of the bytes that the device gives at the same moment."""
    reader = ReplyReader()
    reader.feed(device.answer(encode_command(name, "0001")))
    reply = reader.next()
    return parse_bx(reply) if isinstance(reply, bytes) else parse_tx(str(reply))


@pytest.mark.parametrize("name", ["TX", "BX"])
def test_the_same_pose_from_the_same_bytes(client: object, device: AuroraDevice, name: str) -> None:
    start(client)
    device.clock.sleep(7.5)
    device.tools[1].visibility = NdiVisibility.MISSING
    device.faults.system_status = 0x08
    getattr(ndi, f"ndi{name}")(client, 0x0001)
    transform, port, frame, system = (
        getattr(ndi, f"ndiGet{name}{what}") for what in ("Transform", "PortStatus", "Frame", "SystemStatus")
    )
    frames = ours(device, name)
    tip, reference = frames.tools
    assert transform(client, TIP) == pytest.approx((*tip.quaternion, *tip.position_mm, tip.error_mm), abs=1e-9)
    assert transform(client, REFERENCE) == "MISSING"
    assert reference.visibility is NdiVisibility.MISSING
    assert (port(client, TIP), frame(client, TIP)) == (tip.port_status, tip.frame)
    assert system(client) == frames.system_status == 8


def test_it_reads_our_handles_and_our_tool(client: object) -> None:
    ndi.ndiCommand(client, "INIT:")
    assert ndi.ndiCommand(client, "PHSR:02") == "020A0010B001"
    assert "34801403" in ndi.ndiCommand(client, "PHINF:0A0001")


def test_it_understands_our_refusals(client: object) -> None:
    with pytest.raises(OSError, match="0x01: Invalid command"):
        ndi.ndiCommand(client, "NONSENSE:")


def test_it_finds_our_damage(client: object, device: AuroraDevice) -> None:
    start(client)
    device.faults.damage = 1
    with pytest.raises(OSError, match="CRC"):
        ndi.ndiTX(client, 0x0001)
