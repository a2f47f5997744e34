"""Published results compared with computed ones: checks that need no long solves."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import needleplan as npl
from needleplan.errors import InputError, OutputError
from needleplan.reports.chapters import Effort, Request, reproduce
from needleplan.reports.comparison import Agreement, Comparison, Evidence, measured
from needleplan.scenario import Method, Scenario
from needleplan_thesis.chapter6.partitions import in_obstacles, statements
from needleplan_thesis.chapter6.tables import (
    TABLE_6_2,
    TABLE_6_3,
    Solves,
    formula_states,
    problem,
    processed_states,
    solve_all,
    tables,
)
from tests.cli.commands import needleplan, refused

pytestmark = pytest.mark.study


def test_the_size_of_the_problem_is_the_published_one() -> None:
    thesis = Scenario.read("four_obstacles_thesis")
    verdicts = {each.id: each.verdict for each in problem(thesis)}
    assert len(verdicts) == 5
    assert [each for each, verdict in verdicts.items() if verdict is not Agreement.REPRODUCED] == [
        "ch6/problem/deviation of the noise"
    ]
    assert formula_states(thesis) == pytest.approx(1_152_000)


def test_the_published_tables_are_copied_right() -> None:
    for row in TABLE_6_2:
        # The thesis' own totals of (12, 8) are off: 1850.6 for 1805.6, and by a second.
        off = {((12, 8), "H1"): -45.0, ((12, 8), "H2"): 1.0}.get((row.partitions, row.priority), 0.0)
        assert row.solving_s + row.priorities_s - off == pytest.approx(row.total_s)
    for (columns, rows), (processed, states) in TABLE_6_3.items():
        assert states / processed == pytest.approx(1_152_000 / (columns * rows))


def test_states_of_processed_partitions_are_counted(small: Scenario) -> None:
    solver = replace(small.solver, method=Method.PPVI, priority="H2", partitions=(6, 4))
    table = npl.plan(replace(small, solver=solver))
    # Column 2 of 6, row 0 of 4: x 21 to 30, y 0 to 10, wholly within the rod.
    assert in_obstacles(table) == {8} == set(range(24)) - set(table.stats.order)
    assert processed_states(table) == small.states - 10 * 11 * 36 * 2


@pytest.mark.parametrize(
    ("ours", "verdict"),
    [
        (10.0, Agreement.REPRODUCED),
        (29.9, Agreement.SAME_ORDER),
        (3.4, Agreement.SAME_ORDER),
        (31.0, Agreement.DIFFERS),
    ],
)
def test_the_same_order_is_a_factor_of_three(ours: float, verdict: Agreement) -> None:
    assert measured("a/b/c", 10.0, ours, "s", "why", kind=Evidence.COMPUTED).verdict is verdict


def compared(published: float | str | None, ours: float | str | None) -> Comparison:
    return Comparison("a", published, ours, "s", Agreement.DIFFERS, kind=Evidence.COMPUTED)


def test_ratios() -> None:
    assert compared(4, 1.0).ratio == 0.25
    assert compared(None, 1.0).ratio is None
    assert compared(0, 1.0).ratio is None
    assert compared("four", "five").ratio is None


def test_chapters_that_are_not_there() -> None:
    with pytest.raises(InputError) as raised:
        reproduce(["ch7"], Request(None, Effort.QUICK, print))
    (mistake,) = raised.value.mistakes
    assert mistake.rule == "must be one of ch2, ch3, ch4, ch5, ch6, diagnosis"


def test_a_folder_that_cannot_be(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="cannot be made"):
        reproduce(["ch6"], Request(tmp_path / "file" / "figures", Effort.QUICK, print))


@pytest.mark.parametrize(("chapters", "seeds"), [(["ch2"], "3"), ([], "3"), (["diagnosis"], "0")])
def test_seeds_are_those_of_the_diagnosis(chapters: list[str], seeds: str) -> None:
    refused(needleplan("reproduce", *chapters, "--runs", seeds), "--runs", "diagnosis" if seeds == "3" else "from 1")


def test_no_verdict_depends_on_the_load_of_the_machine(small: Scenario) -> None:
    """Each solve is made up to a thousand times slower; only what is measured changes, and no verdict."""
    solves = solve_all(small, lambda _: None)
    random = np.random.default_rng(4)

    def loaded(table: npl.PolicyTable) -> npl.PolicyTable:
        slow, fast = 10 ** random.uniform(0, 3, 2)
        stats = replace(
            table.stats, seconds_solving=table.stats.seconds_solving * slow,
            seconds_priorities=table.stats.seconds_priorities * fast,
        )  # fmt: skip
        return replace(table, stats=stats)

    slow = Solves(
        loaded(solves.plain), {case: loaded(table) for case, table in solves.partitioned.items()}, loaded(solves.sweep)
    )
    idle, busy = ([*tables(each), *statements(each)] for each in (solves, slow))
    assert [row.verdict for row in idle] == [row.verdict for row in busy]
    changed = {one.id for one, other in zip(idle, busy, strict=True) if one.ours != other.ours}
    unjudged = {row.id for row in idle if row.verdict is Agreement.UNJUDGED}
    assert len(unjudged) == 3 * len(TABLE_6_2) + 2 + 3
    assert changed <= unjudged | {row.id for row in idle if row.verdict is Agreement.OURS}
    assert len(changed & unjudged) >= len(unjudged) - 2
