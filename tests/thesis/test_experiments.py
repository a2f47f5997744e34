"""The experiments of section 6.5 run in the lab twin, and are compared with the thesis."""

from pathlib import Path

import pytest

from needleplan.errors import InputError
from needleplan.reports.chapters import Effort, Request, reproduce
from needleplan.reports.comparison import Agreement
from needleplan_thesis.chapter6 import chapter
from needleplan_thesis.chapter6.phantom import experiments

pytestmark = pytest.mark.study


def test_every_experiment_is_carried_out_and_drawn(tmp_path: Path) -> None:
    found = {each.id.removeprefix("ch6/experiments/"): each for each in experiments(tmp_path, str, seeds=1)}
    assert {name.split()[0] for name in found} == {"6.7", "6.8a", "6.8b", "6.8c", "6.9a", "6.9b"}
    deviation = found["6.7 largest deviation, by the tip filter, median"]
    assert deviation.published == 0.176
    assert isinstance(deviation.ours, float)
    assert 0 < deviation.ours < 3
    assert found["6.8c beyond the rim, median"].published == 0.248
    assert {each.verdict for each in found.values()} <= {Agreement.OURS, Agreement.SAME_ORDER, Agreement.DIFFERS}
    written = [each.name for each in sorted(tmp_path.iterdir())]
    assert written == ["fig_6_7_lab.png", "fig_6_8_lab.png", "fig_6_9_lab.png"]
    assert written == [*chapter.files(Request(tmp_path, Effort.QUICK, str, experiments=True))]


@pytest.mark.parametrize("chapters", [[], ["ch2"], ["ch6", "ch2"]])
def test_experiments_are_those_of_chapter_6(chapters: list[str]) -> None:
    with pytest.raises(InputError, match="--experiments"):
        reproduce(chapters, Request(None, Effort.QUICK, str, experiments=True))
