"""Figs. 5.1 and 5.2: forces on the shaft, and deflection by depth."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from needleplan.models.deflection import Beam, march, solve_uniform
from needleplan.plotting.canvas import BLACK, BLUE, GREEN, GREY, ORANGE, VERMILLION, save, title
from needleplan_thesis.chapter5.insertions import (
    CASES,
    COIL_MM,
    END_MM,
    MEMORY,
    NEEDLE,
    PRINTED,
    DeflectionCase,
    ForceProfile,
    coil_path,
    depths_mm,
    required_force_n,
    tip_force_n,
)
from needleplan_thesis.chapter5.table52 import mean_offset_n, memory_path

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["figure_5_1", "figure_5_2"]


def figure_5_1(folder: Path, step_mm: float) -> None:
    """Draw Fig. 5.1: the needle at a depth of 80 mm, and the cutting force that the estimated radii require.

    The force is drawn over depth, for both readings of the model and the two cases at 15 mm/s.
    """
    from matplotlib.figure import Figure

    case = CASES[2]
    figure = Figure(figsize=(9.6, 4.4), layout="constrained")
    left, right = figure.subplots(1, 2, gridspec_kw={"wspace": 0.08})
    _draw_needle(left, case, step_mm)
    for reading, colour in ((PRINTED, ORANGE), (MEMORY, BLUE)):
        for each, style in ((CASES[2], "-"), (CASES[3], "--")):
            behind = COIL_MM if reading is PRINTED else 0.0
            depth, force = required_force_n(
                reading, each.tissue, each.velocity_mm_s, each.estimated_mm, step_mm, behind_mm=behind
            )
            right.plot(depth, force, style, color=colour, label=f"{reading.name}, {each.name}")
    for each, style in ((CASES[2], "-"), (CASES[3], "--")):
        most = tip_force_n(each.greatest_n or 0.0, each.tissue, each.velocity_mm_s, 0.0)
        right.plot(END_MM, most, "v" if style == "-" else "^", color=VERMILLION, clip_on=False, zorder=5,
                   label=f"limit by the axial force, {each.name[0]}")  # fmt: skip
    right.set(xlabel="depth (mm)", ylabel="cutting force $F_c$ (N)", xlim=(0, END_MM + 3), ylim=(0, None))
    right.legend(frameon=False, fontsize=8, loc="upper left")
    right.set_ylim(top=1.3 * right.get_ylim()[1])  # room for the legend above the lines
    title(right, "(b) Force that the estimated radius requires")
    save(figure, folder / "fig_5_1.png")


def figure_5_2(folder: Path, step_mm: float) -> None:
    """Draw Fig. 5.2: the deflection of the tracker coil against depth, in the four cases."""
    from matplotlib.figure import Figure

    offset = mean_offset_n(step_mm)
    figure = Figure(figsize=(9.0, 6.6), layout="constrained")
    grid = figure.subplots(2, 2, sharex=True, sharey=True)
    for axes, case, letter in zip(grid.flat, CASES, "abcd", strict=True):
        _draw_case(axes, case, offset, step_mm)
        title(axes, f"({letter}) tissue {case.name}")
    for axes in grid[1]:
        axes.set_xlabel("insertion depth (mm)")
    for axes in grid[:, 0]:
        axes.set_ylabel("deflection at the coil (mm)")
    handles, labels = grid[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=2, frameon=False, fontsize=8)
    save(figure, folder / "fig_5_2.png")


def _draw_case(axes: Axes, case: DeflectionCase, offset_n: float, step_mm: float) -> None:
    depth = depths_mm(step_mm)
    arcs = {
        name: radius - np.sqrt(radius**2 - depth**2)
        for name, radius in (("measured", case.measured_mm), ("estimated", case.estimated_mm))
    }
    axes.plot(depth, arcs["measured"], color=BLACK, label="arc of the published measured radius, tangent at the entry")
    axes.plot(depth, arcs["estimated"], "--", color=BLACK, label="arc of the published estimated radius")
    # The largest axial force was published for 15 mm/s; the same force on the bevel is assumed at 10 mm/s.
    known = next(each for each in CASES if each.greatest_n and each.tissue == case.tissue)
    end = tip_force_n(known.greatest_n or 0.0, known.tissue, known.velocity_mm_s, 0.0)
    profiles = (ForceProfile.QUADRATIC, ForceProfile.LINEAR, ForceProfile.SATURATING)
    forces = np.stack([end * profile.of(depth) for profile in profiles])
    _, printed = coil_path(PRINTED, case.tissue, case.velocity_mm_s, forces, step_mm)
    axes.fill_between(depth, printed.min(axis=0), printed.max(axis=0), color=ORANGE, alpha=0.25, linewidth=0)
    axes.plot(
        depth, printed[0], color=ORANGE, label=f"{PRINTED.name}, $F_0$ = 0, quadratic force; band: linear, saturating"
    )
    _, path = memory_path(case, offset_n, step_mm)
    axes.plot(depth, path, color=BLUE, label=f"{MEMORY.name}, $F_0$ = {offset_n:.3f} N for all")
    axes.set_xlim(0, END_MM)
    axes.set_ylim(bottom=0)


def _draw_needle(axes: Axes, case: DeflectionCase, step_mm: float) -> None:
    """Draw needle, cut path and load of the tissue at 80 mm, by the memory model with its required cutting force."""
    depth, force = required_force_n(MEMORY, case.tissue, case.velocity_mm_s, case.estimated_mm, step_mm)
    path = march(NEEDLE, case.tissue, np.concatenate([[0.0], force]), step_mm, case.velocity_mm_s)
    last = Beam.of(NEEDLE, case.tissue, END_MM, float(force[-1]), case.velocity_mm_s)
    shape = solve_uniform(last, depth.size, path.tip_mm[None])
    behind = np.linspace(0, NEEDLE.length_mm, 400)
    needle = np.array([float(shape.at(each)[0]) for each in behind])
    place = END_MM - behind
    inside = place >= 0
    cut = np.interp(place[inside], path.depth_mm, path.tip_mm)
    axes.axvspan(0, END_MM + 8, color="#f3ead9", zorder=0)
    axes.plot(place, needle, color=BLACK, linewidth=1.6, label="needle")
    axes.plot(path.depth_mm, path.tip_mm, "--", color=BLUE, label="path cut by the tip")
    load = 1000 * case.tissue.stiffness_n_mm2 * (cut - needle[inside])
    twin = axes.twinx()
    twin.fill_between(place[inside], load, color=GREEN, alpha=0.3, linewidth=0, label="load of the tissue (N/m)")
    twin.plot([0, END_MM], [0, 0], color=GREY, linewidth=0.5)
    twin.set_ylabel("load of the tissue (N/m)", color=GREEN)
    twin.set_ylim(-4 * abs(load).max(), 4 * abs(load).max())
    axes.set(
        xlabel="distance from the entry (mm)",
        ylabel="lateral position (mm)",
        xlim=(-NEEDLE.length_mm + END_MM, END_MM + 8),
    )
    axes.legend(frameon=False, fontsize=8, loc="upper left")
    title(axes, f"(a) Needle at 80 mm, tissue {case.name}, $F_c$ = {force[-1]:.3f} N")
