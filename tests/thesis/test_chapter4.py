from pathlib import Path

import numpy as np
import pytest

from needleplan.reports.chapters import Effort, Request, reproduce
from needleplan.reports.comparison import Agreement, Comparison
from needleplan_thesis.chapter4 import chapter
from needleplan_thesis.chapter4.phantoms import AGAR_PHANTOM, GELATIN_PHANTOM, SHARES
from needleplan_thesis.chapter4.response import response

pytestmark = pytest.mark.study


@pytest.fixture(scope="module")
def figures(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("figures")


@pytest.fixture(scope="module")
def comparisons(figures: Path) -> dict[str, Comparison]:
    rows = reproduce(["ch4"], Request(figures, Effort.QUICK, lambda _: None))
    assert len({each.id for each in rows}) == len(rows)
    return {each.id: each for each in rows}


def test_every_figure_is_drawn(comparisons: dict[str, Comparison], figures: Path) -> None:
    assert comparisons
    drawn = {each.name for each in figures.glob("*.png")}
    assert drawn == {"figure_4_3.png", "figure_4_4.png", "figure_4_5.png", "figure_4_6.png"}
    assert drawn == {*chapter.files(Request(figures, Effort.QUICK, str))}


def test_every_difference_has_its_reason(comparisons: dict[str, Comparison]) -> None:
    asking = (Agreement.SAME_ORDER, Agreement.DIFFERS, Agreement.NOT_REPRODUCED, Agreement.IMPOSSIBLE)
    assert all(each.reason for each in comparisons.values() if each.verdict in asking)
    assert all(each.id.startswith("ch4/") for each in comparisons.values())


def test_the_published_response_and_what_it_implies() -> None:
    rows = {each.id: each for each in response()}
    for phantom, lost, late in (("gelatin", 0.15, 0.1), ("agar", 0.04, 0.06)):
        attenuation = rows[f"ch4/figure 4.6/{phantom}/attenuation at 0.1 Hz, 5 ms"]
        lag = rows[f"ch4/figure 4.6/{phantom}/lag at 0.1 Hz, 5 ms"]
        for each, tolerance in ((attenuation, lost), (lag, late)):
            assert isinstance(each.ours, float)
            assert isinstance(each.published, float)
            assert abs(each.ours - each.published) <= tolerance
        implied = rows[f"ch4/figure 4.6/{phantom}/interval that the attenuation implies"].ours
        assert implied == pytest.approx(23.3, abs=0.2)
    assert rows["ch4/equation 4.2/transfer function of the recursion, epsilon 1"].verdict is Agreement.REPRODUCED
    assert rows["ch4/equation 4.2/transfer function of the recursion, epsilon 0.5"].verdict is Agreement.NOT_REPRODUCED


def test_the_simulated_phantom_has_the_stated_properties() -> None:
    gelatin, agar = GELATIN_PHANTOM.trial(2.0, 50.0), AGAR_PHANTOM.trial(2.0, 50.0)
    assert gelatin.lag_deg == pytest.approx(10.13, abs=0.5)
    assert agar.lag_deg == pytest.approx(2.99, abs=0.5)
    again = GELATIN_PHANTOM.trial(2.0, 50.0)
    assert (again.record["force_n"] == gelatin.record["force_n"]).all()
    sizes = np.ptp(gelatin.sensors_mm, axis=1)
    np.testing.assert_allclose(sizes / sizes[2], SHARES, atol=0.1)
