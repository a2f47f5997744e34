"""`needleplan entry` of an anatomy or a 3D table: ranks the entries."""

from __future__ import annotations

import argparse
import csv
import io
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from needleplan.artifacts import FileKind, file_format
from needleplan.cli.answer import by_table, complain, note, one_line, percent, print_json, working
from needleplan.cli.options import require_absent, require_ending, require_inputs_kept, require_outputs, require_rules
from needleplan.cli.parser import Parser
from needleplan.cli.plan_space import breath_lines, lattice_record, lattice_texts
from needleplan.cli.uncertainty import promise_lines, promise_record, promised, read_registered, read_uncertainty

if TYPE_CHECKING:
    from needleplan.anatomy import Anatomy
    from needleplan.planning import (
        AnatomyPlane,
        EntryMap,
        ResidualSuccess,
        SpaceEntry,
        SpaceTable,
        Success,
        Uncertainty,
        Unreached,
    )

__all__ = ["add_anatomy", "is_anatomy", "require_no_anatomy", "run_anatomy_entries", "run_table_entries"]

# Number of ranked entries, and number of executions with noise from the best one.
_TOP, _RUNS = 5, 1000
# Options of `entry` that hold for anatomies only, and for tables only, with their defaults.
_ANATOMY_ONLY = (
    "--top", "--exact-entry", "--output", "--figure", "--markups", "--transform", "--vtp", "--plane-out", "--success",
    "--rank",
)  # fmt: skip
_PLANE_ONLY = ("--edge", "--at", "--needle")


def add_anatomy(parser: Parser, top: Any) -> None:
    """Declare the options of an anatomy; `top` reads the number of ranked entries."""
    parser.add_argument("--top", type=top, metavar="N", help=f"number of entries to rank, in 3D (default: {_TOP})")
    parser.add_argument(
        "--exact-entry", action="store_true",
        help="rank by the success without an error of the entry, not by the expected success with one, in 3D",
    )  # fmt: skip
    parser.add_argument(
        "--rank", metavar="expected|all|NAME",
        help="with several targets: rank by the expected number reached, by all, or by one (default: expected)",
    )  # fmt: skip
    parser.add_argument(
        "--markups", metavar="FILE.mrk.json", help="write the ranked entries and paths in 3D for 3D Slicer"
    )
    parser.add_argument(
        "--transform",
        metavar="FILE",
        help="write the best entry in 3D as a transform for 3D Slicer (.tfm, .h5)",
    )
    parser.add_argument(
        "--vtp", metavar="FILE.vtp", help="write entry points, paths and executions in 3D for VTK, in RAS"
    )
    parser.add_argument(
        "--plane-out", metavar="SCENARIO.toml",
        help="plan also in the best plane through its axis, and write the scenario of this plane",
    )  # fmt: skip
    parser.rename("--plane", "--plane-out")
    parser.add_argument(
        "--success", metavar="FILE.nii.gz", help="write the success of the best direction in 3D as a volume"
    )


def is_anatomy(file: str) -> bool:
    """Return whether `entry` reads a file as an anatomy: it is one, or its name ends in `.toml`."""
    return file_format(file).kind is FileKind.ANATOMY or file.lower().endswith(".toml")


def require_no_anatomy(options: argparse.Namespace) -> None:
    """Raise InputError if an option was given that needs an anatomy."""
    require_absent(options, _ANATOMY_ONLY, "holds for an anatomy and a 3D table, and this is a table in the plane")


def run_anatomy_entries(options: argparse.Namespace) -> int:
    """Solve an anatomy, rank its entries, and return the exit code: 1 if no entry reaches the target, else 0."""
    from needleplan.anatomy import Anatomy
    from needleplan.planning import rank_entries

    require_absent(options, ["--verify-key"], "holds for a policy table, and this is an anatomy")
    _require_options(options)
    anatomy = Anatomy.read(options.table)
    require_inputs_kept(options)
    if anatomy.file.anatomy.targets:
        from needleplan.cli.target_entries import run_target_entries

        return run_target_entries(anatomy, options, _TOP if options.top is None else options.top)
    uncertainty = _uncertainty(options)
    return _run_entries(options, lambda: rank_entries(anatomy), uncertainty, anatomy)


def run_table_entries(table: SpaceTable, options: argparse.Namespace) -> int:
    """Rank the entries of a 3D table, and return the exit code: 1 if no entry reaches the target, else 0."""
    from needleplan.planning import entry_map

    _require_options(options)
    uncertainty = _uncertainty(options)
    return _run_entries(options, lambda: entry_map(table), uncertainty)


def _uncertainty(options: argparse.Namespace) -> Uncertainty:
    """Return the uncertainty that the options state. Raises InputError also for an option that several targets need."""
    require_absent(options, ["--rank"], "holds for an anatomy with several targets, and this has one")
    return read_uncertainty(options, read_registered(options.registration))


def _require_options(options: argparse.Namespace) -> None:
    """Raise InputError or OutputError if an option cannot be used."""
    from needleplan.anatomy import require_transform_name
    from needleplan.config import Integer

    require_absent(options, _PLANE_ONLY, "holds for a table in the plane, and this is one in 3D")
    require_rules(options, {"--top": Integer(1, 10_000)})
    require_ending("--markups", options.markups, ".mrk.json")
    require_transform_name("--transform", options.transform)
    require_ending("--vtp", options.vtp, ".vtp")
    require_ending("--plane-out", options.plane_out, ".toml")
    require_ending("--success", options.success, ".nii.gz")
    require_outputs(
        options, [options.table], options.output, options.markups, options.transform, options.vtp, options.plane_out,
        options.success,
    )  # fmt: skip


def _run_entries(
    options: argparse.Namespace,
    entries_of: Callable[[], EntryMap],
    uncertainty: Uncertainty,
    anatomy: Anatomy | None = None,
) -> int:
    """Rank the entries, write what the options name, and return the exit code."""
    from needleplan.anatomy import obstacle_distances
    from needleplan.planning import best_plane, impossible_message, success_in_breath, unreached

    top = _TOP if options.top is None else options.top
    with working(options, "looking for the best entries"):
        entries = entries_of()
        numbers = entries.best(top, exact=options.exact_entry)
        ranked = [entries.entry(number) for number in numbers]
        realised = entries.realised(numbers[0], _RUNS) if ranked else None
        promise = promised(entries.table, uncertainty, entries.poses[numbers[0]]) if ranked else None
        several = anatomy and anatomy.file.anatomy.entries
        regions = [anatomy.entry_name(each.position_mm) for each in ranked] if anatomy and several else []
        near = [obstacle_distances(anatomy, entries.path_mm(each)) for each in numbers] if anatomy else []
        breathes = ranked and anatomy and anatomy.file.breathing
        breaths = success_in_breath(entries.table, anatomy, entries.poses[numbers]) if anatomy and breathes else []
        hopeless = None if entries.impossible else unreached(entries, numbers)
        plane = best_plane(entries.table.scenario) if options.plane_out else None
    if ranked and numbers[0] != entries.first(exact=options.exact_entry):
        note(
            f"the first of {top} candidates is not the first of those that `plan`, `insert` and `lab` compare; start "
            "there with --start"
        )
    _write(options, entries, numbers, plane)
    if options.figure:
        from needleplan.planning import draw_entries
        from needleplan.plotting import save

        save(draw_entries(entries, numbers[0] if numbers else None), options.figure)
        note(f"drew {options.figure}")
    if options.json:
        print_json(
            _record(entries, ranked, realised, hopeless, near, breaths, regions)
            | promise_record(promise)
            | ({"plane": _plane_record(entries, plane)} if plane else {})
        )
    else:
        print(one_line(entries.table.scenario.title or options.table))
        for line in _lines(entries, ranked, realised, regions, exact=options.exact_entry):
            print(one_line(line))
        for line in breath_lines(breaths):
            print(line)
        for rank, risks in enumerate(near if options.verbose else [], start=1):
            listed = ", ".join(f"{name} {distance:.1f} mm" for name, distance in risks.items())
            print(one_line(f"  nearest to path {rank}: {listed or 'no obstacle within 30 mm'}"))
        for topic, text in {**promise_lines(promise), **lattice_texts(entries.table.scenario)}.items():
            print(one_line(f"  {topic}: {text}"))
        if plane:
            print(one_line(_plane_line(entries, plane)))
    if entries.impossible:
        return complain(impossible_message(entries))
    if hopeless:
        return complain(f"{hopeless}; that no path exists is not proved")
    if not entries.reachable:
        return complain(
            "no entry reaches the target in 0.1 % of executions by the table; that no path exists is not proved"
        )
    return 0


def _write(options: argparse.Namespace, entries: EntryMap, ranked: Sequence[int], plane: AnatomyPlane | None) -> None:
    """Write the files that the options name, except the figure."""
    from needleplan.artifacts import write_whole
    from needleplan.planning import entries_vtp, markups_text, success_bytes

    contents: tuple[tuple[str | None, Callable[[], bytes]], ...] = (
        (options.output, lambda: _csv(entries, ranked).encode()),
        (options.markups, lambda: markups_text(entries, ranked).encode()),
        (options.transform if len(ranked) else None, lambda: _transform(entries.entry(ranked[0]), options.transform)),
        (options.vtp, lambda: entries_vtp(entries, ranked)),
        (options.plane_out, lambda: plane.table.scenario.to_toml().encode() if plane else b""),
        (options.success, lambda: success_bytes(entries)),
    )
    for file, content in contents:
        if file:
            write_whole(file, content())
            note(f"wrote {file}")
    if options.transform and not len(ranked):
        note(f"did not write {options.transform}: no entry reaches the target in 0.1 % of executions by the table")


def _transform(entry: SpaceEntry, file: str) -> bytes:
    """Return the file of the transform that places a needle, with its tip at the origin and along +x, at an entry."""
    from needleplan.anatomy import pose_matrix, transform_bytes

    return transform_bytes(pose_matrix(entry.position_mm, entry.direction), Path(file).suffix.lower())


def _lines(
    entries: EntryMap, ranked: list[SpaceEntry], realised: float | None, regions: list[str], *, exact: bool
) -> Iterator[str]:
    """Yield the lines of the ranked list. Losses of success are in percentage points."""
    reaching = int((entries.success >= 0.5).sum())
    yield (
        f"  {len(entries.success)} entry points, {reaching} with a success of at least 50 % by the table; "
        f"{entries.stats['states']:,} states in {entries.stats['seconds']:.1f} s"
    )
    for count in entries.table.kept_entries.counts:
        yield f"  {count}"
    if not ranked:
        return
    order = "success" if exact else "expected success, that with an error of the entry"
    yield f"  success by {ranked[0].success.runs:,} executions of each entry; ordered by {order}"
    alone, expected = f"{'success':>7}  {'95 % interval':^15}", f"{'expected':>8}"
    yield (
        f"  rank  {'  '.join((alone, expected) if exact else (expected, alone))}  clearance  length  turns  "
        "loss 2 mm  loss 2 deg  entry R, A, S (mm)      direction R, A, S"
    )
    for number, each in enumerate(ranked, start=1):
        place = ", ".join(f"{x:.1f}" for x in each.position_mm)
        along = ", ".join(f"{x:.3f}" for x in each.direction)
        missed = "" if each.reached else "  (its path without noise misses)"
        low, high = each.success.interval or (0.0, 1.0)
        alone = f"{percent(each.success.value):>7}  {percent(low):>6} - {percent(high):>6}"
        expected = f"{percent(each.expected_success):>8}"
        yield (
            f"  {number:>4}  {'  '.join((alone, expected) if exact else (expected, alone))}  "
            f"{each.clearance_mm:>6.1f} mm  {each.length_mm:>3.0f} mm  "
            f"{each.turns:>5}  {100 * each.shift_cost:>9.1f}  {100 * each.tilt_cost:>10.1f}  "
            f"{place:<22}  {along}{f'  in {regions[number - 1]}' if regions else ''}{missed}"
        )
    if realised is not None:
        yield f"  the best entry reached the target in {percent(realised)} of {_RUNS:,} executions with noise"


def _plane_record(entries: EntryMap, plane: AnatomyPlane) -> dict[str, Any]:
    """Return the JSON record of the best plane, whose success is by its table.

    `success_in_space` is that of the 3D plan at the same entry; None outside of the cone.
    """
    from needleplan.planning import Success

    path, pose, frame = plane.table.path(plane.entry), plane.pose(plane.entry), entries.grid.frame
    in_space = _success_in_space(entries, plane)
    return {
        "angle_rad": plane.angle_rad,
        **Success(plane.success).record(),
        **(in_space.record("success_in_space") if in_space else {"success_in_space": None}),
        "position_mm": frame.world(pose.position_mm).tolist(),
        "direction": (pose.tangent @ frame.axes).tolist(),
        "length_mm": path.length_mm,
        "turns": len(path.turns),
        "seconds": plane.seconds,
    }


def _success_in_space(entries: EntryMap, plane: AnatomyPlane) -> Success | None:
    """Return the success of the 3D plan at the entry of a plane, or None outside of the cone."""
    pose = plane.pose(plane.entry)
    return entries.table.estimate(pose) if entries.table.contains(pose) else None


def _plane_line(entries: EntryMap, plane: AnatomyPlane) -> str:
    path, in_space = plane.table.path(plane.entry), _success_in_space(entries, plane)
    same = f"in 3D there {in_space}" if in_space else "its entry is outside of the cone"
    return (
        f"  best plane: success {by_table(plane.success)} in the plane, without the noise across it; {same}; "
        f"{path.length_mm:.0f} mm, {len(path.turns)} turns"
    )


def _record(
    entries: EntryMap,
    ranked: list[SpaceEntry],
    realised: float | None,
    hopeless: Unreached | None,
    near: list[dict[str, float]],
    breaths: list[ResidualSuccess],
    regions: list[str],
) -> dict[str, Any]:
    is_possible = entries.reachable and not hopeless
    answer = "impossible" if entries.impossible else "possible" if is_possible else "not decided"
    return {
        "title": entries.table.scenario.title,
        "answer": answer,
        "unreached": asdict(hopeless) if hopeless else None,
        "entry_points": len(entries.success),
        "limits": [asdict(count) for count in entries.table.kept_entries.counts],
        "states": entries.stats["states"],
        "lattice": lattice_record(entries.table.scenario),
        "seconds": entries.stats["seconds"],
        "realised_success": realised,
        "runs": _RUNS,
        "entries": [
            each.record()
            | ({"obstacles_mm": near[place]} if near else {})
            | ({"entry_region": regions[place]} if regions else {})
            | ({"breathing": [breath.record(place) for breath in breaths]} if breaths else {})
            for place, each in enumerate(ranked)
        ],
    }


def _csv(entries: EntryMap, ranked: Sequence[int]) -> str:
    """Return the entry map as CSV, in RAS: the ranked entries in their order, then all others by success.

    `success_source` says whether a success is by executions or by the table.
    """
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(
        ["r_mm", "a_mm", "s_mm", "direction_r", "direction_a", "direction_s", "success", "success_low", "success_high",
         "success_source", "success_runs", "table_success", "cost", "clearance_mm", "length_mm", "turns", "reached",
         "rank"]
    )  # fmt: skip
    places = entries.grid.frame.world(entries.poses[:, :3])
    along = entries.poses[:, 3:] @ entries.grid.frame.axes
    paths = entries.paths
    ranks = {number: rank for rank, number in enumerate(ranked, start=1)}
    for number in (*ranks, *(int(each) for each in entries.order if int(each) not in ranks)):
        success = entries.known_success(number)
        interval = [f"{each:.6g}" for each in success.interval or ()] or ["", ""]
        place = [f"{each:.6g}" for each in (*places[number], *along[number], success.value)]
        by_table = (entries.success[number], entries.value[number])
        path = (paths.clearance_mm[number], paths.length_mm[number])
        rows.writerow(
            [*place, *interval, success.source, success.runs, *(f"{each:.6g}" for each in (*by_table, *path)),
             int(paths.turns[number]), int(paths.reached[number]), ranks.get(number, "")]
        )  # fmt: skip
    return text.getvalue()
