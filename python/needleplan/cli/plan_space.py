"""`needleplan plan ANATOMY.toml`: solve an anatomy into a 3D policy table.

What `plan` and `entry` say about the lattice of an anatomy, what it changes of the file, and about breathing.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import asdict, replace
from typing import TYPE_CHECKING, Any

from needleplan.cli.answer import complain, note, one_line, percent, print_json, print_summary, working
from needleplan.cli.options import require_absent, require_inputs_kept, require_outputs, sign_key
from needleplan.cli.uncertainty import promise_lines, promise_record, promised, read_registered, read_uncertainty
from needleplan.errors import InputError, Mistake, ScenarioError

if TYPE_CHECKING:
    from needleplan.anatomy import Anatomy, SpaceScenario
    from needleplan.identification.space_curvature import SpaceCurvature
    from needleplan.planning import ResidualSuccess, SpacePose, SpaceTable, Success

__all__ = ["best_record", "breath_lines", "lattice_record", "lattice_texts", "run_plan_space"]


def lattice_texts(scenario: SpaceScenario) -> dict[str, str]:
    """Return the printed lines about the lattice, by topic."""
    grid, chosen = scenario.grid, scenario.file.lattice.spacing_mm is None
    why = " (the finest of 1, 1.5 and 2 mm that states and memory permit)" if chosen else ""
    texts = {
        "lattice": f"spacing {grid.frame.spacing_mm:g} mm{why}, steps of {scenario.step_mm:g} mm, collisions in voxels "
        f"of {grid.voxel_mm:.2g} mm"
    }
    if grid.loss is not None:
        closed = grid.loss.closed_passage_mm
        widest = f"the widest passage closed has {closed:.1f} mm" if closed > 0 else "no passage is closed"
        texts["obstacles"] = (
            f"{100 * grid.loss.obstacle_share:.1f} % of their volume is free on the lattice; "
            f"{100 * grid.loss.free_share:.1f} % of the free volume is closed (margin, needle, voxels); {widest}"
        )
    return texts


def lattice_record(scenario: SpaceScenario) -> dict[str, Any]:
    """Return the JSON record of the lattice."""
    grid = scenario.grid
    return {
        "spacing_mm": grid.frame.spacing_mm,
        "spacing_chosen": scenario.file.lattice.spacing_mm is None,
        "step_mm": scenario.step_mm,
        "voxel_mm": grid.voxel_mm,
        "needle_thickness_mm": scenario.needle.thickness_mm,
        "loss": asdict(grid.loss) if grid.loss else None,
    }


def breath_lines(breaths: Sequence[ResidualSuccess], whose: str = "") -> Iterator[str]:
    """Yield the lines on the success of the ranked entries with a residual of breathing."""
    if not breaths:
        return
    title = f"  {whose}success if breathing moves the tissue by up to"
    yield f"{title}  " + "  ".join(f"{each.residual_mm:>4g} mm" for each in breaths)
    for number in range(len(breaths[0].entries)):
        yield f"  {number + 1:>4}{'':{len(title) - 6}}  " + "  ".join(
            f"{percent(each.entries[number].value):>7}" for each in breaths
        )


# Upper end of the 95 % interval of the best entry by the table below which others are tried, too.
_DOUBTFUL = 0.01
# Options of `plan` that hold in the plane only.
_PLANE_ONLY = ("--needle", "--tissue", "--accept-units", "--push", "--edge")


def run_plan_space(options: argparse.Namespace) -> int:
    """Solve the anatomy, write the table, and return the exit code: 1 if no entry reaches the target, else 0."""
    require_absent(options, _PLANE_ONLY, "holds for a scenario in the plane, and this is an anatomy")
    from needleplan.anatomy import Anatomy
    from needleplan.planning import entry_map, impossible_message, plan_space, unreached

    require_outputs(options, [options.scenario, options.sign_key, options.registration, *options.after], options.output)
    registered = read_registered(options.registration)
    read_uncertainty(options, registered)
    key = sign_key(options)
    scenario = _scenario(Anatomy.read(options.scenario), options.target_name)
    found = _curvature(scenario, options.after) if options.after else None
    if found is not None:
        note(f"curvature: {found}, from {len(found.insertions)} insertions")
        low, high = found.interval
        if low <= 1 <= high:
            note(
                "the interval contains 1: the insertions do not show that the needle bends otherwise than planned, and "
                "the plan by their ratio may be worse; record more insertions, or plan without --after"
            )
        scenario = scenario.rescaled(found.ratio)
    ratios = (found.interval[0] / found.ratio, found.interval[1] / found.ratio) if found else None
    uncertainty = read_uncertainty(options, registered, curvature_ratio=ratios)
    require_inputs_kept(options)
    with working(options, "solving") as tell:

        def show(finished: float, *_: float) -> None:
            if finished < 1:
                tell("solving", finished)
            else:
                tell("looking for the best entry")

        table = plan_space(scenario, file=options.output, sign_key=key, streamed=options.stream or None, progress=show)
        best = table.best_entry().pose
        success = table.estimate(best)
        is_doubtful = success.interval is not None and success.interval[1] < _DOUBTFUL
        hopeless = impossible = None
        promise = None if is_doubtful else promised(table, uncertainty, best)
        if is_doubtful:
            entries = entry_map(table)
            impossible = impossible_message(entries) if entries.impossible else None
            hopeless = None if impossible else unreached(entries)
    if options.figure:
        from needleplan.planning import draw_entries
        from needleplan.plotting import save

        save(draw_entries(entry_map(table)), options.figure)
        note(f"drew {options.figure}")
    if options.json:
        about = {"title": scenario.title, "scenario_digest": scenario.digest, "digest": table.digest}
        files = {"table": options.output, "figure": options.figure}
        curvature = {"curvature": _found(found)} if found else {}
        print_json(about | best_record(table, best, success) | promise_record(promise) | files | curvature)
    else:
        from needleplan.cli.table_poses import poses_of

        shape = " x ".join(map(str, table.shape))
        lines = {
            "best entry": poses_of(table).text(best),
            "success": str(success),
            **promise_lines(promise),
            "grid": f"{shape} = {table.stats.states:,} states (slices, directions, y, z)",
            **lattice_texts(scenario),
            "solver": f"{table.stats.status.replace('_', ' ')}, {table.stats.seconds:.3f} s",
        }
        if options.output or options.figure:
            lines["wrote"] = ", ".join(file for file in (options.output, options.figure) if file)
        print_summary(options, one_line(scenario.title or options.scenario), lines, {"table": table.digest})
    if impossible:
        return complain(impossible)
    if hopeless:
        return complain(f"{hopeless}; that no path exists is not proved")
    if is_doubtful:
        note("the best entry by the table hardly reaches the target; `needleplan entry` estimates others, too")
    return 0


def _scenario(anatomy: Anatomy, target: str | None) -> SpaceScenario:
    """Return what is planned: the only target, or the one with a name. Raises InputError for an unknown name."""
    from needleplan.anatomy import SpaceScenario

    names = [each.name for each in anatomy.file.anatomy.targets]
    if target is None and names:
        rule = f"is required for an anatomy with several targets: {', '.join(names)}"
        raise InputError(Mistake("--target-name", "", rule))
    try:
        return SpaceScenario.of(anatomy, target)
    except ScenarioError as error:
        wrong = [replace(each, key="--target-name") if each.key == "target_name" else each for each in error.mistakes]
        raise ScenarioError(wrong, error.source) from None


def _curvature(scenario: SpaceScenario, files: list[str]) -> SpaceCurvature:
    """Return the ratio of the curvature that recorded insertions show. Raises InputError for other recordings."""
    from needleplan.control import recorded_insertion
    from needleplan.identification.space_curvature import space_curvature

    return space_curvature(scenario, [recorded_insertion(file, scenario) for file in files])


def _found(found: SpaceCurvature) -> dict[str, object]:
    """Return the JSON record of an identified ratio."""
    insertions = [{"recording": name, "ratio": ratio, "sd": sd} for name, ratio, sd in found.insertions]
    return {"ratio": found.ratio, "sd": found.sd, "interval": found.interval, "insertions": insertions}


def best_record(table: SpaceTable, best: SpacePose, success: Success) -> dict[str, object]:
    """Return the numbers of a table and its best entry."""
    from needleplan.cli.table_poses import poses_of

    decision = table.lookup(best)
    return {
        "shape": table.shape,
        "states": table.stats.states,
        "lattice": lattice_record(table.scenario),
        "status": table.stats.status,
        "seconds": table.stats.seconds,
        "best_entry": {
            **poses_of(table).record(best),
            **success.record(),
            "table_success": decision.success,
            "value": decision.value,
        },
    }
