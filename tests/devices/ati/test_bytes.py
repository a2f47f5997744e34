import contextlib
import math

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from needleplan.devices.ati import BoxSettings, parse_configuration
from needleplan.devices.ati.rdt import (
    RdtCommand,
    RdtOrder,
    RdtRecord,
    RdtSeverity,
    StreamWatch,
    decode_records,
    decode_request,
    encode_records,
    encode_request,
    read_status,
)
from needleplan.errors import ConfigurationError, ProtocolError

U32 = st.integers(0, 2**32 - 1)
I32 = st.integers(-(2**31), 2**31 - 1)
RECORDS = st.builds(RdtRecord, U32, U32, U32, st.tuples(I32, I32, I32, I32, I32, I32))


def test_the_bytes_of_the_manual() -> None:
    assert encode_request(RdtCommand.START) == bytes.fromhex("1234 0002 00000000")
    assert encode_request(RdtCommand.BIAS) == bytes.fromhex("1234 0042 00000000")
    assert encode_request(RdtCommand.START, 5) == bytes.fromhex("1234 0002 00000005")
    record = RdtRecord(1, 35, 0x8002_0000, (1_000_000, -2_000_000, 3, 4, 5, -1))
    raw = "00000001 00000023 80020000 000f4240 ffe17b80 00000003 00000004 00000005 ffffffff"
    assert encode_records([record]) == bytes.fromhex(raw)
    assert decode_records(bytes.fromhex(raw)) == [record]


@given(st.lists(RECORDS, min_size=1, max_size=40))
def test_records_come_back(records: list[RdtRecord]) -> None:
    assert decode_records(encode_records(records)) == records


@given(st.binary(max_size=1600))
@example(b"")
@example(bytes(36 * 41))
def test_any_datagram_is_records_or_a_protocol_error(datagram: bytes) -> None:
    try:
        records = decode_records(datagram)
    except ProtocolError:
        assert len(datagram) % 36 or not 36 <= len(datagram) <= 36 * 40
    else:
        assert encode_records(records) == datagram


@given(st.binary(max_size=12))
@example(bytes.fromhex("1234 0099 00000000"))
def test_any_request_is_one_or_a_protocol_error(datagram: bytes) -> None:
    with contextlib.suppress(ProtocolError):
        command, samples = decode_request(datagram)
        assert encode_request(command, samples) == datagram


@given(st.binary(max_size=300) | st.text().map(str.encode))
@example(b"<a><cfgcpf>1e999</cfgcpf></a>")
@example(b'<?xml version="1.0" encoding="nonsense"?><a/>')
@example(b'<?xml version="1.0"?><!DOCTYPE a [<!ENTITY b "c">]><a>&b;</a>')
def test_any_page_is_a_configuration_error(page: bytes) -> None:
    with pytest.raises(ConfigurationError):
        parse_configuration(page)


def test_every_mistake_of_a_configuration_is_told() -> None:
    with pytest.raises(ConfigurationError) as caught:
        parse_configuration(
            b"<a><cfgcpf>0</cfgcpf><scfgfu>N</scfgfu><scfgtu>Nft</scfgtu><comrdte>Disabled</comrdte></a>"
        )
    assert [each.key for each in caught.value.mistakes] == ["cfgcpf", "cfgcpt", "scfgtu", "comrdte"]


@pytest.mark.parametrize(
    ("unit", "newton"),
    [("N", 1), ("kN", 1000), ("lbf", 4.4482216152605), ("klbf", 4448.2216152605), ("kg", 9.80665), ("kgf", 9.80665)],
)
def test_forces_in_newtons(unit: str, newton: float) -> None:
    found = parse_configuration(BoxSettings(counts_per_force=250, force_unit=unit).xml())
    assert found.newton_per_count == pytest.approx(newton / 250, rel=1e-12)


@pytest.mark.parametrize(
    ("unit", "newton_mm"),
    [("N-mm", 1), ("Nmm", 1), ("N-m", 1000), ("Nm", 1000), ("kN-m", 1e6), ("lbf-in", 112.9848290276167),
     ("lbf-ft", 1355.8179483314004), ("kg-cm", 98.0665), ("kgf-cm", 98.0665)],
)  # fmt: skip
def test_torques_in_newton_millimetres(unit: str, newton_mm: float) -> None:
    found = parse_configuration(BoxSettings(counts_per_torque=4000, torque_unit=unit).xml())
    assert found.newton_mm_per_count == pytest.approx(newton_mm / 4000, rel=1e-12)


@pytest.mark.parametrize(
    ("status", "product", "severity", "note"),
    [(0, "Net F/T", RdtSeverity.HEALTHY, ""),
     (0x8002_0000, "Net F/T", RdtSeverity.SUSPECT, "saturated"),
     (0x8001_0000, "Net F/T", RdtSeverity.SUSPECT, "threshold"),
     (0x8003_0000, "Net F/T", RdtSeverity.SUSPECT, "saturated"),
     (0x8002_0004, "Net F/T", RdtSeverity.FAULT, "temperature"),
     (0x8000_0000, "Net F/T", RdtSeverity.FAULT, "error"),
     (0x0000_8000, "Net F/T", RdtSeverity.FAULT, "status bit 15"),
     (0x0000_0008, "Ethernet Axia", RdtSeverity.SUSPECT, "busy"),
     (0x8800_0000, "Ethernet Axia80", RdtSeverity.SUSPECT, "gage out of range"),
     (0x8002_0000, "ETHERNET AXIA", RdtSeverity.FAULT, "status bit 17"),
     (0x8000_0004, "Ethernet Axia", RdtSeverity.FAULT, "broken gage")],
)  # fmt: skip
def test_the_status_word_by_product(status: int, product: str, severity: RdtSeverity, note: str) -> None:
    found, notes = read_status(status, product)
    assert found is severity
    assert note in " ".join(notes)


@given(U32, st.text(max_size=10))
def test_every_status_word_says_something(status: int, product: str) -> None:
    severity, notes = read_status(status, product)
    assert (severity is RdtSeverity.HEALTHY) == (status == 0) == (not notes)


@given(U32, U32, st.lists(st.sampled_from(["next", "lose", "again", "late"]), max_size=60))
def test_a_stream_is_followed_across_the_wrap(rdt: int, ft: int, story: list[str]) -> None:
    """The slow twin knows every record by its number without wrap."""
    watch, sent, got = StreamWatch(), 0, {0}

    def see(number: int) -> RdtOrder:
        record = RdtRecord((rdt + number) % 2**32, (ft + 35 * number) % 2**32, 0, (0,) * 6)
        return watch.see(record, sent * 5_000_000).order

    see(0)
    for event in story:
        if event == "lose":
            sent += 1
        elif event == "next":
            sent += 1
            assert see(sent) is RdtOrder.NEXT
            got.add(sent)
        elif event == "again":
            assert see(max(got)) is RdtOrder.DUPLICATE
        elif missing := set(range(max(got))) - got:
            assert see(min(missing)) is RdtOrder.LATE
            got.add(min(missing))
    assert watch.counts.lost == max(got) + 1 - watch.counts.received
    assert watch.counts.lost - watch.counts.late == len(set(range(max(got))) - got)


@given(st.lists(RECORDS, max_size=50))
def test_any_records_are_judged(records: list[RdtRecord]) -> None:
    watch = StreamWatch()
    verdicts = [watch.see(record, index) for index, record in enumerate(records)]
    assert watch.counts.received == sum(each.order in (RdtOrder.NEXT, RdtOrder.AFRESH) for each in verdicts)
    assert all(each.lost >= 0 and math.isfinite(each.lost) for each in verdicts)
