"""The pages of the reference say what the code does: every cause, every limit, every fault and its test."""

import csv
import re
from dataclasses import fields

from needleplan.control.safety import Cause, SafetyLimits, Severity
from needleplan.control.safety._states import MotionOrder, Order
from needleplan.control.safety._table import transition_table
from tests import pages
from tests.control.faults.robot_faults import BORNE, SERIOUS
from tests.control.faults.sensors import RUNNING, STARTING

SAFETY = (pages.ROOT / "docs/reference/safety.md").read_text()


def rows(text: str) -> list[list[str]]:
    """Return the cells of all tables."""
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in text.splitlines() if line.startswith("|")]


def test_the_transition_table_is_that_of_the_code() -> None:
    table = transition_table()
    assert (pages.ROOT / "docs/reference/transitions.csv").read_text() == table
    assert {str(each) for each in (*Order, *MotionOrder)} <= {re.split("[ ,]", line)[0] for line in table.splitlines()}


def test_every_cause_stands_with_what_it_leads_to() -> None:
    told: dict[str, str] = {}
    for cells in rows(SAFETY):
        if len(cells) == 3 and cells[2].split(",")[0] in ("FAULT", "PAUSED", "DISABLED"):
            told |= {name: cells[2].split(",")[0] for name in re.findall(r"`(\w+)`", cells[0])}
    severe = {Severity.FAULT: "FAULT", Severity.PAUSE: "PAUSED"}
    expected = {str(each): severe[each.severity] for each in Cause if each.severity in severe}
    assert {name: told.get(name) for name in expected} == expected | {"stop_ordered": "DISABLED"}
    for each in Cause:
        assert f"`{each}`" in SAFETY


def test_every_limit_stands_with_its_default() -> None:
    told: dict[str, str] = {}
    for cells in rows(SAFETY):
        names = re.findall(r"`(\w+)`", cells[0])
        values = re.findall(r"`([-\d.]+)`", cells[1]) if len(cells) == 4 else []
        told |= dict(zip(names, values, strict=False))
    defaults = {each.name: str(each.default) for each in fields(SafetyLimits) if each.default is not None}
    assert {name: told.get(name) for name in defaults} == defaults


def faults() -> list[dict[str, str]]:
    """Return the rows of the table of faults: number, fault, ends in, cause, ms, tests."""
    with (pages.ROOT / "docs/reference/faults.csv").open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_every_fault_stands_in_the_table() -> None:
    assert {fault["number"] for fault in faults()} == {str(number) for number in range(1, 37)}


def test_every_fault_has_a_test_that_is_there() -> None:
    for fault in faults():
        assert fault["tests"], fault
        for name, _, test in (each.partition("::") for each in fault["tests"].split()):
            assert f"def {test}(" in pages.test_file(name).read_text(), (name, test)


def test_every_injected_fault_ends_as_the_table_says() -> None:
    listed = {(each["number"], each["fault"]): (each["ends in"], each["cause"]) for each in faults()}
    for fault in RUNNING:
        assert listed[str(fault.number), fault.name] == (str(fault.state), str(fault.cause or "")), fault.name
    for start in STARTING:
        assert listed[str(start.number), start.name] == ("DISABLED", str(start.cause)), start.name
    for name, _, cause, _ in SERIOUS:
        number, _, words = name.partition(" ")
        assert listed[number, words] == ("FAULT", str(cause)), name
    for name, _ in BORNE:
        number, _, words = name.partition(" ")
        assert listed[number, words] == ("ENABLED", ""), name
