"""Entry point of `needleplan reproduce ch4`: all comparisons and figures, in the order of the chapter."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from needleplan.reports.chapters import Effort
from needleplan_thesis.chapter4.loops import compensated, draw_loops, loop_rows
from needleplan_thesis.chapter4.phantoms import AGAR, AGAR_PHANTOM, FORCE_HZ, GELATIN, GELATIN_PHANTOM, PHANTOMS
from needleplan_thesis.chapter4.response import draw_bode, response
from needleplan_thesis.chapter4.sensors import draw_sensors, sensor_rows, tissue_rows
from needleplan_thesis.citations import cited

if TYPE_CHECKING:
    from needleplan.reports.chapters import Request
    from needleplan.reports.comparison import Comparison

__all__ = ["files", "run"]


def files(_: Request) -> tuple[str, ...]:
    """Return the names of the files that `run` writes into the output folder."""
    return ("figure_4_3.png", "figure_4_4.png", "figure_4_5.png", "figure_4_6.png")


def run(request: Request) -> list[Comparison]:
    """Return the comparisons of the chapter; draw Figures 4.3 to 4.6 if the request names a folder."""
    quick = request.effort is Effort.QUICK
    cycles, rate_hz = (2.0, 50.0) if quick else (4.0, FORCE_HZ)
    request.note("chapter 4: loops of friction and velocity")
    gelatin = compensated(GELATIN_PHANTOM.trial(cycles, rate_hz), GELATIN.alpha1)
    agar = compensated(AGAR_PHANTOM.trial(cycles, rate_hz), AGAR.alpha1)
    if request.folder:
        draw_loops(gelatin, GELATIN, request.folder / "figure_4_3.png")
        draw_sensors(gelatin, request.folder / "figure_4_4.png")
        draw_loops(agar, AGAR, request.folder / "figure_4_5.png")
        draw_bode(request.folder)
    measured = [
        *loop_rows(gelatin, GELATIN, "figure 4.3"),
        *sensor_rows(gelatin),
        *loop_rows(agar, AGAR, "figure 4.5"),
        *tissue_rows(
            PHANTOMS[:1] if quick else PHANTOMS, cycles, rate_hz, request.note, both=request.effort is Effort.FULL
        ),
    ]
    if quick:
        measured = [
            replace(each, reason=f"quick: two cycles at 50 Hz; {each.reason}".rstrip("; ")) for each in measured
        ]
    return cited([*response(), *measured])
