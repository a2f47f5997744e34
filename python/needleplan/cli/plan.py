"""`needleplan plan`: solve a scenario and write its policy table."""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any, cast

from needleplan.artifacts import CallRepr, FileKind, file_format
from needleplan.cli.answer import by_table, complain, note, one_line, percent, print_json, print_summary, working
from needleplan.cli.options import (
    EDGES,
    add_answer,
    add_edge,
    add_figure,
    add_output,
    entry_record,
    grid_line,
    guide_line,
    guide_record,
    require_absent,
    require_ending,
    require_outputs,
    sign_key,
)
from needleplan.cli.parser import Parser
from needleplan.cli.plan_space import run_plan_space
from needleplan.cli.push import PUSH_FORM, PUSH_HELP, read_push
from needleplan.cli.uncertainty import (
    add_uncertainty,
    promise_lines,
    promise_record,
    promised,
    read_registered,
    read_uncertainty,
)
from needleplan.errors import InputError, Mistake, ScenarioError
from needleplan.extras.progress_bar import solve_text

if TYPE_CHECKING:
    from needleplan.planning import Entry, PolicyTable, Pose, Promise, Resolution
    from needleplan.scenario import Identified, Scenario

__all__ = ["UNREACHABLE_SUCCESS", "Replaced", "add_to", "run", "with_identified"]

_LOOSE_SUCCESS = 0.01  # bound on the error of the success probabilities above which a warning is printed
_POOR_SUCCESS = 0.8  # success probability of the best entry below which a warning is printed
UNREACHABLE_SUCCESS = 0.001
"""Success probability of the best entry below which the target counts as unreachable."""

_DETERRENT = 10  # ratio of failure cost to the cost of crossing the workspace, up to which a hint is printed


@dataclass(frozen=True)
class Replaced(CallRepr):
    """Record that an identified radius replaced a radius of the scenario.

    `place` names the needle or the tissue, `found` is the identified curvature, and `file` is the model file.
    """

    place: str
    found: Identified
    file: str

    def record(self) -> dict[str, Any]:
        """Return the JSON record of the replacement. Limits of the interval are None if there is no interval."""
        low, high = self.found.interval_mm
        found = {"radius_mm": self.found.radius_mm, "interval_mm": [_finite(low), _finite(high)]}
        return {"place": self.place, **found, "kind": self.found.kind, "model": self.file, "digest": self.found.digest}


def add_to(commands: Any) -> None:
    """Add this command and its options to the program's parser."""
    parser: Parser = commands.add_parser(
        "plan",
        help="solve a scenario or an anatomy into a policy table",
        description="Solve a scenario, or an anatomy in 3D, into a policy table. Exit code 1: not converged, or the "
        "target is unreachable.",
    )
    parser.add_argument(
        "scenario",
        metavar="SCENARIO.toml",
        help="a scenario file, the name of a shipped scenario, or an anatomy file (a 3D plan)",
    )
    add_output(parser, "TABLE.h5", "write the table")
    parser.add_argument("--sign-key", metavar="FILE", help="sign the table with this secret key, at least 16 bytes")
    parser.add_argument(
        "--needle",
        metavar="MODEL.toml",
        help="model of the needle: its radius replaces that of the needle and of its layers",
    )
    parser.add_argument(
        "--tissue",
        action="append",
        default=[],
        metavar="NAME=MODEL.toml",
        help="replace the radius of the tissue with this name by the radius of this model; may be given several times",
    )
    parser.add_argument(
        "--accept-units", action="store_true", help="accept implausible sizes, such as a radius in metres"
    )
    parser.add_argument(
        "--push",
        metavar=PUSH_FORM,
        help=f"push of the needle, by which the target is planned smaller: {PUSH_HELP}",
    )
    parser.add_argument(
        "--after",
        action="append",
        default=[],
        metavar="RUN.mcap",
        help="of an anatomy: multiply all curvatures by the ratio that this recorded insertion shows; may be given "
        "several times",
    )
    parser.add_argument("--target-name", metavar="NAME", help="target of an anatomy with several to plan for")
    parser.add_argument(
        "--stream",
        action="store_true",
        help="of an anatomy: write each slice when it is solved, as for tables that need more than half of the memory",
    )
    add_uncertainty(parser)
    add_edge(parser)
    add_figure(parser, "the path from the best entry and the success map")
    add_answer(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run the command and return the exit code: 1 if not converged or the target is unreachable, else 0.

    Raises InputError (ScenarioError, OutputError and others) for wrong options and files.
    """
    require_ending("--output", options.output, ".h5", ".hdf5")
    if file_format(options.scenario).kind is FileKind.ANATOMY:
        return run_plan_space(options)
    require_absent(options, ["--target-name", "--after", "--stream"], "needs an anatomy, and this is a scenario")
    from needleplan.planning import read_problem

    options.edge = options.edge or EDGES[0]
    scenario, identified = with_identified(cast("Scenario", read_problem(options.scenario)), options)
    shift_mm = _target_shift_mm(scenario, options)
    if shift_mm is not None:
        scenario = replace(scenario, target=replace(scenario.target, radius_mm=scenario.target.radius_mm - shift_mm))
    model = next((each.found for each in identified if each.place == "needle"), None)
    planned_per_mm = 1 / scenario.needle.curvature_radius_mm
    uncertainty = read_uncertainty(options, read_registered(options.registration), model, planned_per_mm)
    inputs = [options.scenario, options.sign_key, options.registration, *(each.file for each in identified)]
    require_outputs(options, inputs, options.output)
    key = sign_key(options)
    from needleplan.planning import draw_plan, guide_pose, heading_refinement, plan, resolution

    if (times := heading_refinement(scenario)) > 1:
        few = scenario.motion.headings
        note(f"planned with {few * times} headings: between {few}, a step would add noise")
    note(f"{one_line(scenario.title or options.scenario)}: {scenario.states:,} states, method {scenario.solver.method}")
    with working(options, "solving") as tell:
        try:
            table = plan(scenario, lambda *state: tell(solve_text(*state)), accept_units=options.accept_units)
        except ScenarioError as error:
            raise ScenarioError(error.mistakes, options.scenario) from None
        if options.output:
            tell(f"writing {options.output}")
            table.write(options.output, sign_key=key, force=True)
        tell("looking for the best entry")
        best = table.best_entry(options.edge)
        tell("executing the plan")
        checked = resolution(table, best)
        promise = promised(table, uncertainty, best) if best.success >= UNREACHABLE_SUCCESS else None
        if options.figure:
            tell(f"drawing {options.figure}")
            draw_plan(table, best, options.figure)
    entry = model.entry if model else None
    guide = guide_pose(best.pose, entry) if entry else None
    if options.json:
        more = {"identified": [each.record() for each in identified]} | (guide_record(guide) if guide else {})
        more |= promise_record(promise) | ({"target_shift_mm": shift_mm} if shift_mm is not None else {})
        print_json(_record(table, best, options) | {"resolution": checked.record()} | more)
    else:
        _print((table, checked, promise), best, identified, options, guide)
    return _judged(table, checked, best, options.edge)


def _judged(table: PolicyTable, checked: Resolution, best: Entry[Pose], edge: str) -> int:
    """Print what speaks against the plan, and return the exit code."""
    from needleplan.planning import Status

    scenario = table.scenario
    if table.stats.status is not Status.CONVERGED:
        return complain(f"not converged: {table.stats.status.replace('_', ' ')}, residual {table.stats.residual:.3g}")
    for warning in checked.warnings:
        note(f"warning: {warning}")
    if scenario.solver.success_bound and table.stats.success_error_bound > _LOOSE_SUCCESS:
        note(
            "warning: the success probabilities are not proven: they may be wrong by up to "
            f"{percent(table.stats.success_error_bound)}; the policy may hardly ever end, as where a step is much "
            "shorter than grid.spacing_mm"
        )
    if best.success < UNREACHABLE_SUCCESS:
        return complain(f"the target cannot be reached from the {edge} edge")
    if best.success < _POOR_SUCCESS:
        note(
            f"warning: even the best entry on the {edge} edge reaches the target in only "
            f"{percent(best.success)} of the executions, by the table{_giving_up(scenario)}"
        )
    return 0


def _target_shift_mm(scenario: Scenario, options: argparse.Namespace) -> float | None:
    """Return the displacement (mm) of a target that the tip reaches, by tip and shaft, or None without `--push`.

    A tip that comes within the radius less this displacement of the planned centre is in the target, however far the
    target has been pushed. Raises InputError for wrong numbers, and if nothing of the radius is left.
    """
    if not options.push:
        return None
    shift = read_push(options.push).shift_mm
    target_mm = scenario.target.radius_mm
    if not shift < target_mm:
        rule = f"pushes the target by {shift:.2f} mm, which must be less than its radius, {target_mm:g} mm"
        raise InputError(Mistake("--push", options.push, rule))
    note(f"target: pushed away by up to {shift:.2f} mm; planned with a radius of {target_mm - shift:.2f} mm")
    return shift


def _giving_up(scenario: Scenario) -> str:
    """Return a hint if a failure may cost less than the way to the target: with a discount, or low failure costs.

    Otherwise returns an empty text.
    """
    objective = scenario.objective
    dearest_per_mm = objective.insertion_per_mm + (objective.clearance_per_mm or 0.0)
    way_through = dearest_per_mm * scenario.workspace.width_mm + objective.rotation
    if objective.discount == 1 and min(objective.collision, objective.exit) > _DETERRENT * way_through:
        return ""
    return "; failures are so cheap in [objective] that giving up may cost less than a long way round"


def _record(table: PolicyTable, best: Entry[Pose], options: argparse.Namespace) -> dict[str, Any]:
    scenario = table.scenario
    stats = asdict(table.stats)
    del stats["order"]
    return {
        "title": scenario.title,
        "scenario_digest": scenario.digest,
        "digest": table.digest,
        "shape": scenario.shape,
        "method": scenario.solver.method,
        **stats,
        "edge": options.edge,
        "best_entry": entry_record(best),
        "table": options.output,
        "figure": options.figure,
    }


def _print(
    planned: tuple[PolicyTable, Resolution, Promise | None],
    best: Entry[Pose],
    identified: Sequence[Replaced],
    options: argparse.Namespace,
    guide: Pose | None,
) -> None:
    table, checked, promise = planned
    scenario, stats = table.scenario, table.stats
    lines = {
        "best entry": f"{best.pose}; success {by_table(best.success)}, cost {best.value:.4g}",
        **(promise_lines(promise) or {"promise": str(checked.realised)}),
        **({"guide": guide_line(guide)} if guide else {}),
        "solver": f"{scenario.solver.method}: {stats.status.replace('_', ' ')}, error at most {stats.error_bound:.3g}, "
        f"{stats.seconds:.3f} s",
    }
    if options.output or options.figure:
        lines["wrote"] = ", ".join(file for file in (options.output, options.figure) if file)
    more = {"grid": grid_line(scenario)} | {each.place: str(each.found) for each in identified}
    more |= {
        "work": f"{stats.sweeps:.2f} sweeps, {stats.backups:,} backups, residual {stats.residual:.3g}; "
        f"{len(stats.order)} of {stats.partitions} partitions, {stats.partitions_processed} visits",
        "time": f"{stats.seconds_solving:.3f} s solving, {stats.seconds_priorities:.3f} s priorities",
        "scenario": scenario.digest,
        "table": table.digest,
    }
    print_summary(options, scenario.title or options.scenario, lines, more)


def with_identified(scenario: Scenario, options: argparse.Namespace) -> tuple[Scenario, list[Replaced]]:
    """Replace radii by those of the model files in `--needle` and `--tissue`; return the scenario and the replacements.

    Prints a remark on each replacement. Raises ScenarioError if an option is wrong or the scenario does not permit a
    radius, and ModelError if a model file is wrong.
    """
    files = [("", options.needle)] if options.needle else []
    for each in options.tissue:
        name, equals, file = each.partition("=")
        if not (name and equals and file):
            raise ScenarioError(Mistake("--tissue", each, "must be NAME=MODEL.toml"))
        files.append((name, file))
    replaced = []
    for name, file in files:
        from needleplan.models import ModelFile
        from needleplan.scenario import identified, within

        found = identified(ModelFile.read(file), file)
        layers = len(scenario.needle.layers)
        try:
            scenario = scenario.with_curvature(
                within(found.pieces, scenario.workspace.width_mm) or found.curvature_per_mm, tissue=name
            )
        except ScenarioError as error:
            raise ScenarioError(error.mistakes, options.scenario) from None
        place = f"tissue {name}" if name else "needle"
        also = f"; it replaces {layers} layer{'s' * (layers != 1)} too" if layers and not name else ""
        note(f"{place}: {found}, {file}{also}")
        replaced.append(Replaced(place, found, file))
    return scenario, replaced


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
