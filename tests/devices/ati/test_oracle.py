"""pynetft, an independent client, is content with our box, and reads the same wrench from the same bytes."""

from itertools import islice

import pytest

from needleplan.devices.ati import BoxSettings, NetFtBox, NetFtServer, parse_configuration
from needleplan.devices.ati.rdt import RdtRecord, StreamWatch
from tests.devices.ati.bench import Wrench

pynetft = pytest.importorskip("pynetft", reason="the independent client pynetft is not installed (extra: test)")

N = {"N": 1.0, "kN": 1000.0, "lbf": 4.4482216152605}
N_MM = {"N-m": 1000.0, "N-mm": 1.0, "lbf-in": 112.9848290276167}


def config(server: NetFtServer) -> object:
    return pynetft.Config(sensor_host=server.host, rdt_port=server.port, http_port=server.http_port)


@pytest.mark.parametrize(("force_unit", "torque_unit", "counts"), [("N", "N-m", 1e6), ("lbf", "lbf-in", 4000.0)])
def test_the_same_wrench_from_the_same_counts(force_unit: str, torque_unit: str, counts: float) -> None:
    settings = BoxSettings(counts, counts, force_unit, torque_unit)
    with NetFtServer(NetFtBox(Wrench(), settings)) as server, pynetft.Client(config(server), queue_size=100) as client:
        assert client.wait_for_first_sample(3)
        samples = list(islice(client.samples(timeout=1), 20))
        ours = parse_configuration(settings.xml())
        watch = StreamWatch()
        for sample in samples:
            assert (sample.force_unit.value, sample.torque_unit.value) == (force_unit, torque_unit)
            record = RdtRecord(sample.rdt_sequence, sample.ft_sequence, sample.status, sample.raw_wrench)
            watch.see(record, sample.received_at_ns)
            for axis in range(3):
                force_n = record.counts[axis] * ours.newton_per_count
                torque_n_mm = record.counts[3 + axis] * ours.newton_mm_per_count
                assert sample.force[axis] * N[force_unit] == pytest.approx(force_n, rel=1e-12)
                assert sample.torque[axis] * N_MM[torque_unit] == pytest.approx(torque_n_mm, rel=1e-12)
        assert watch.counts.received == 20
        health = client.health()
        assert (health.malformed_count, health.device_error_count, health.ft_backward_count) == (0, 0, 0)


def test_the_same_verdict_on_loss_duplicates_and_disorder() -> None:
    with NetFtServer(NetFtBox(Wrench())) as server, pynetft.Client(config(server), queue_size=200) as client:
        assert client.wait_for_first_sample(3)
        server.box.faults.lose = 4
        server.box.faults.duplicate = 2
        server.box.faults.instead = [b"garbage"]
        counts: tuple[int, ...] = ()
        for _ in islice(client.samples(timeout=1), 2000):  # samples from before the faults may wait in the queue
            health = client.health()
            counts = health.lost_count, health.duplicate_count, health.malformed_count
            if counts == (4, 2, 1):
                break
        assert counts == (4, 2, 1)


def test_the_same_faults() -> None:
    fail_stop = pynetft.RecoveryPolicy.FAIL_STOP
    with NetFtServer(NetFtBox(Wrench())) as server:
        settings = pynetft.Config(server.host, server.port, server.http_port, recovery_policy=fail_stop)
        with pynetft.Client(settings, queue_size=10) as client:
            assert client.wait_for_first_sample(3)
            server.box.faults.status = 0x8800_0000
            with pytest.raises(pynetft.SensorFaultError):
                list(islice(client.samples(timeout=1), 400))
            assert client.health().fault_code is pynetft.FaultCode.SERIOUS_STATUS
