"""One class of tests on a box in this process, on one behind real sockets, and on hardware where there is one."""

import os
import socket
from collections import deque
from collections.abc import Iterator

import pytest

from needleplan.devices import ForceSensor
from needleplan.devices.ati import ForceLimits, NetFt, NetFtBox, NetFtServer
from needleplan.devices.ati.rdt import RdtCommand, RdtRecord, encode_records, encode_request
from needleplan.errors import AddressError, ConfigurationError, DeviceFault
from tests.devices.ati.bench import Bench, Wrench
from tests.devices.contract import ForceSensorContract

HARDWARE = "NEEDLEPLAN_TEST_FORCE"
PATIENT = ForceLimits(silence_s=2.0, start_s=2.0)
"""For a machine with other things to do than to run a simulated box at 200 Hz."""


@pytest.fixture
def server() -> Iterator[NetFtServer]:
    with NetFtServer(NetFtBox(Wrench())) as running:
        yield running


class TestInThisProcess(ForceSensorContract):
    @pytest.fixture
    def sensor(self) -> ForceSensor:
        return Bench().sensor()


class TestOnSockets(ForceSensorContract):
    @pytest.fixture
    def sensor(self, server: NetFtServer) -> Iterator[ForceSensor]:
        with NetFt.open(server.address, limits=PATIENT) as opened:
            yield opened


@pytest.mark.skipif(HARDWARE not in os.environ, reason=f"set {HARDWARE} to the address of an unloaded sensor")
class TestOnHardware(ForceSensorContract):
    @pytest.fixture
    def sensor(self) -> Iterator[ForceSensor]:
        with NetFt.open(os.environ[HARDWARE]) as opened:
            yield opened


def test_10_a_datagram_of_somebody_else_is_not_a_sample(server: NetFtServer) -> None:
    with (
        NetFt.open(server.address, limits=PATIENT) as sensor,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger,
    ):
        stranger.sendto(encode_records([RdtRecord(7, 7, 0, (99_000_000,) * 6)]), ("127.0.0.1", sensor.local_port))
        samples = [sensor.read(1) for _ in range(5)]
        assert all(each is not None and each.force_n[0] == pytest.approx(1, abs=0.1) for each in samples)
        assert sensor.unknown_senders == 1


def test_15_a_second_client_takes_the_stream_over_real_sockets(server: NetFtServer) -> None:
    with NetFt.open(server.address) as first, NetFt.open(server.address, limits=PATIENT) as second:
        with pytest.raises(DeviceFault, match="another client"):
            deque(iter(lambda: first.read(0.2), None), maxlen=0)
        assert second.read(0.2) is not None


def test_17_a_bias_by_another_client_over_real_sockets(server: NetFtServer) -> None:
    limits = ForceLimits(silence_s=2.0, start_s=2.0, poll_s=0.05)
    with NetFt.open(server.address, limits=limits) as sensor, socket.socket(type=socket.SOCK_DGRAM) as stranger:
        sensor.bias()
        sensor.read(1)
        stranger.sendto(encode_request(RdtCommand.BIAS), (server.host, server.port))
        with pytest.raises(DeviceFault, match="another client has biased it"):
            deque(iter(lambda: sensor.read(0.5), None), maxlen=0)


def test_the_units_come_from_the_box(server: NetFtServer) -> None:
    settings = server.box.settings
    settings.force_unit, settings.counts_per_force = "lbf", 5000
    settings.torque_unit, settings.counts_per_torque = "N-mm", 100
    with NetFt.open(server.address, limits=PATIENT) as sensor:
        sample = sensor.read(1)
        assert sample is not None
        assert sample.force_n == pytest.approx((1, -2, 0), abs=0.02)
        assert sample.torque_n_mm == pytest.approx((30, 0, 0), abs=0.03)


def test_wrong_addresses_are_refused_before_anything_is_sent(server: NetFtServer) -> None:
    for address, message in {
        "tcp://127.0.0.1:1": "udp://host",
        "udp://127.0.0.1?slot=16": "from 0 to 15",
        "udp://127.0.0.1?http_prot=1": "did you mean",
        "udp://127.0.0.1?http_port=0": "from 1 to 65535",
    }.items():
        with pytest.raises(AddressError, match=message):
            NetFt.open(address)
    server.box.settings.force_unit = "stone"
    with pytest.raises(ConfigurationError, match=r"netftapi2.xml: scfgfu = stone: must be one of N, kN"):
        NetFt.open(server.address)
    assert server.box.client is None


def test_nobody_at_the_address_is_a_fault(server: NetFtServer) -> None:
    with socket.create_server(("127.0.0.1", 0)) as free:
        http_port = free.getsockname()[1]
    with pytest.raises(DeviceFault, match=r"force sensor cannot be read: Connection refused$"):
        NetFt.open(f"udp://127.0.0.1:{server.port}?http_port={http_port}")
