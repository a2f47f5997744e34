"""Figures with margins that were set and not measured: nothing is cut off. Measured here, as a layout would."""

import pytest
from matplotlib.figure import Figure

from needleplan.diagnosis import Library, diagnose
from needleplan.models import Model, ModelFile
from needleplan.models.effects import effects_of
from needleplan.reports.diagnosis import pictures
from needleplan.reports.diagnosis.report import report_of
from needleplan.reports.diagnosis.traces import traces_of
from needleplan.signals import Record
from tests.diagnosis import tip_trials, trials


@pytest.mark.study
@pytest.mark.parametrize(
    ("base", "records"),
    [
        (trials.BASE, trials.recordings({"puncture": {"size": 0.3, "depth_mm": 33.3, "bulge_mm": 2.5}})),
        (tip_trials.BASE, tip_trials.recordings({"curvature_layer": {"size": 0.6, "depth_mm": 30.0}}, seed=3)),
    ],
)
def test_every_figure_holds_all_its_texts(base: Model, records: list[Record], monkeypatch: pytest.MonkeyPatch) -> None:
    figures: list[Figure] = []

    def achieved(figure: Figure) -> str:
        figures.append(figure)
        return "<svg/>"

    monkeypatch.setattr(pictures, "_svg", achieved)
    library = Library(effects_of(base.channel), base)
    found = diagnose(base, records, library=library)
    report_of(found, ModelFile(base, {}, ()), library, None, traces_of(found))
    assert len(figures) > 5
    for figure in figures:
        box, (width, height) = figure.get_tightbbox(), figure.get_size_inches()
        assert box.x0 > -0.01 and box.y0 > -0.01 and box.x1 < width + 0.01 and box.y1 < height + 0.01  # noqa: PT018
        panels = [ax.get_window_extent() for ax in figure.axes]
        assert min(each.width for each in panels[:-1] or panels) > 0.5 * figure.dpi * min(width, 4)
