"""`needleplan check-realtime`, and what `insert` makes of its measurement."""

from __future__ import annotations

import json
import platform
from dataclasses import replace
from pathlib import Path

import pytest

from needleplan.cli import main
from needleplan.cli.realtime import require_prompt
from needleplan.control.realtime import Promptness, measured_file, priority
from needleplan.errors import InputError


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return tmp_path


def prompt() -> Promptness:
    return Promptness(platform.node(), priority(), 1.0, (0.1, 1.0, 10.0), 3, (5.0, 6.0, 15.0), 100, 0)


@pytest.mark.parametrize("line", ["udp", "pty"])
def test_it_measures_writes_and_says_which_limits_hold(
    cache: Path, capsys: pytest.CaptureFixture[str], line: str
) -> None:
    code = main(["check-realtime", "--robot-line", line, "--seconds", "0.01", "--json"])
    told = json.loads(capsys.readouterr().out)
    assert code == int(not told["holds"])
    assert told["stops"] + told["missing"] == 1
    if told["stops"]:  # the one try is missing if the machine paused before its sample
        assert told["gaps"] > 10
        assert 0 < told["stop_ms"][0] < 5000
    # Two frames of 77 bytes at 460,800 baud take 3.34 ms
    assert [each["limit_ms"] for each in told["limits"]] == [
        15.0,
        pytest.approx(10.0 if line == "udp" else 6.658, abs=1e-3),
    ]
    assert told["holds"] == all(each["worst_ms"] <= each["limit_ms"] for each in told["limits"])
    stored = json.loads(measured_file(priority(), line=line == "pty").read_text())
    assert stored["stop_ms"] == told["stop_ms"]
    assert measured_file(priority()).parent == cache / "needleplan"


def test_without_a_measurement_and_with_one_that_holds_nothing_is_refused() -> None:
    require_prompt("udp://robot")
    assert prompt().holds
    prompt().write()
    require_prompt("udp://robot")


@pytest.mark.parametrize(
    ("change", "limit"),
    [
        ({"gap_ms": (5.0, 6.0, 15.1)}, "heartbeat gap: 15.1 ms measured, at most 15 ms"),
        ({"stop_ms": (0.1, 1.0, 10.1)}, "sample to STOP: 10.1 ms measured, at most 10 ms"),
        ({"missing": 1}, "sample to STOP"),
        ({"stops": 0}, "sample to STOP"),
    ],
)
def test_a_limit_that_does_not_hold_is_refused_with_the_remedy(change: dict[str, object], limit: str) -> None:
    replace(prompt(), **change).write()  # type: ignore[arg-type]
    with pytest.raises(InputError, match=limit) as refusal:
        require_prompt("udp://robot")
    assert "chrt -f 20" in str(refusal.value)


def test_a_serial_line_is_judged_by_its_own_measurement_without_one_by_that_over_udp() -> None:
    replace(prompt(), missing=1).write()
    with pytest.raises(InputError):
        require_prompt("serial:///dev/ttyUSB0")
    replace(prompt(), line=True, stop_ms=(0.1, 1.0, 6.0)).write()
    require_prompt("serial:///dev/ttyUSB0")
    with pytest.raises(InputError):
        require_prompt("udp://robot")
    prompt().write()
    replace(prompt(), line=True, stop_ms=(0.1, 1.0, 7.0)).write()
    with pytest.raises(InputError, match=r"7 ms measured, at most 6\.66 ms"):
        require_prompt("serial:///dev/ttyUSB0")


def test_a_measurement_of_another_machine_or_one_that_is_damaged_does_not_count() -> None:
    replace(prompt(), host="elsewhere", missing=1).write()
    require_prompt("udp://robot")
    measured_file(priority()).write_text("{")
    require_prompt("udp://robot")
    measured_file(priority()).write_text('{"host": 1}')
    require_prompt("udp://robot")
