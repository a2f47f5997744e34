"""`needleplan plan ANATOMY.toml`: solve an anatomy into a 3D policy table."""

from __future__ import annotations

import argparse
from dataclasses import replace
from typing import TYPE_CHECKING

from needleplan.cli.answer import complain, note, print_json, print_summary, working
from needleplan.cli.lattice_report import lattice_record, lattice_texts
from needleplan.cli.options import require_inputs_kept, require_outputs, sign_key
from needleplan.cli.streams import one_line
from needleplan.cli.uncertainty import promise_lines, promise_record, promised, read_registered, read_uncertainty
from needleplan.errors import InputError, Mistake, ScenarioError

if TYPE_CHECKING:
    from needleplan.anatomy import Anatomy, SpaceScenario
    from needleplan.identification.space_curvature import SpaceCurvature
    from needleplan.planning import SpacePose, SpaceTable, Success

__all__ = ["best_record", "run_plan_space"]

# Upper end of the 95 % interval of the best entry by the table below which others are tried, too.
_DOUBTFUL = 0.01
# Options of `plan` that hold in the plane only, with their defaults.
_PLANE_ONLY: dict[str, object] = {
    "--needle": None,
    "--tissue": [],
    "--accept-units": False,
    "--push": None,
    "--edge": None,
}


def run_plan_space(options: argparse.Namespace) -> int:
    """Solve the anatomy, write the table, and return the exit code: 1 if no entry reaches the target, else 0."""
    for name, default in _PLANE_ONLY.items():
        value = getattr(options, name.removeprefix("--").replace("-", "_"))
        if value != default:
            raise InputError(Mistake(name, str(value), "holds for a scenario in the plane, and this is an anatomy"))
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
