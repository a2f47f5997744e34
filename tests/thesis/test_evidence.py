"""Every verdict of `needleplan reproduce` states its kind, and none compares a value with itself."""

from dataclasses import replace

import pytest

from needleplan.reports.comparison import Agreement, Comparison, Evidence, by_evidence
from needleplan_thesis.chapter2.parameters import forward
from needleplan_thesis.citations import cited


@pytest.mark.parametrize(
    ("verdict", "kind"),
    [(Agreement.IMPOSSIBLE, Evidence.COMPUTED), (Agreement.REPRODUCED, Evidence.IMPOSSIBLE)],
)
def test_verdict_and_kind_do_not_contradict_each_other(verdict: Agreement, kind: Evidence) -> None:
    with pytest.raises(ValueError, match="contradict"):
        Comparison("a/b/c", 1.0, None, "", verdict, kind=kind)


def test_a_goal_is_no_published_number() -> None:
    with pytest.raises(ValueError, match="goal"):
        Comparison("a/b/c", 1.0, 2.0, "", Agreement.MET, kind=Evidence.COMPUTED)


def test_a_number_of_the_thesis_without_a_citation_is_refused() -> None:
    row = Comparison("ch3/Table 3.5/I, case 1, total", 29.7, 30.0, "mN", Agreement.DIFFERS, kind=Evidence.COMPUTED)
    earlier = replace(row, id="ch3/Table 3.9/a", earlier=True)
    assert [comparison.source for comparison in cited([row, earlier])] == [
        "thesis, Table 3.5, line 2106: I, case 1, total", "",
    ]  # fmt: skip
    with pytest.raises(KeyError, match=r"Table 3\.9"):
        cited([replace(row, id="ch3/Table 3.9/a")])


def test_counts_by_verdict_and_kind() -> None:
    def row(verdict: Agreement, kind: Evidence) -> Comparison:
        return Comparison("a/b/c", 1.0, 2.0, "", verdict, kind=kind)

    same = Agreement.REPRODUCED
    rows = [row(same, Evidence.ARITHMETIC), row(same, Evidence.COMPUTED), row(same, Evidence.ARITHMETIC)]
    rows.append(row(Agreement.DIFFERS, Evidence.OWN_DATA))
    assert by_evidence(rows) == {
        same: {Evidence.COMPUTED: 1, Evidence.ARITHMETIC: 2},
        Agreement.DIFFERS: {Evidence.OWN_DATA: 1},
    }


def test_the_peak_is_not_the_end_of_a_search_window() -> None:
    peaks = {each.id: str(each.ours) for each in forward() if each.id.startswith("ch2/fig. 2.2/")}
    (flat,) = (text for name, text in peaks.items() if "B/B 10 mm/s" in name)
    (steep,) = (text for name, text in peaks.items() if "A/A 10 mm/s" in name)
    assert "at 19.4 mm" in flat
    assert "peak 0.219 N at 6.9 mm" in steep
