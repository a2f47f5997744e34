"""`needleplan entry` of an anatomy with several targets: ranks the entry points, with one insertion for each target."""

from __future__ import annotations

import argparse
import csv
import io
from collections.abc import Iterator, Sequence
from dataclasses import asdict, replace
from typing import TYPE_CHECKING, Any

from needleplan.cli.answer import complain, note, one_line, percent, print_json, working
from needleplan.cli.plan_space import breath_lines, lattice_record, lattice_texts
from needleplan.errors import InputError, Mistake

if TYPE_CHECKING:
    from needleplan.anatomy import Anatomy
    from needleplan.planning import ResidualSuccess, TargetEntry, TargetMap

__all__ = ["run_target_entries"]

# Options of `entry` that hold for one target only.
_ONE_ONLY = (
    "figure", "transform", "vtp", "plane_out", "success", "entry_sd_mm", "heading_sd_deg", "tre_mm", "curvature_ratio",
    "registration",
)  # fmt: skip


def run_target_entries(anatomy: Anatomy, options: argparse.Namespace, top: int) -> int:
    """Solve an anatomy for its targets, rank its entries, and return the exit code: 1 if a target is not reached."""
    from needleplan.artifacts import write_whole
    from needleplan.planning import rank_for_targets, targets_markups_text

    for name in _ONE_ONLY:
        if (value := getattr(options, name)) is not None:
            rule = "holds for one target, and this anatomy has several: plan one with `needleplan plan --target-name`"
            raise InputError(Mistake(f"--{name.replace('_', '-')}", str(value), rule))
    names, rank = [target.name for target in anatomy.file.anatomy.targets], options.rank or "expected"
    if rank not in ("expected", "all", *names):
        rule = f"must be expected, all or the name of a target: {', '.join(names)}"
        raise InputError(Mistake("--rank", rank, rule))
    with working(options, "looking for the best entries"):
        found = rank_for_targets(anatomy)
        ranked = found.best(top, rank=rank, exact=options.exact_entry)
        breaths = _in_breath(anatomy, found, ranked)
    if options.output:
        write_whole(options.output, _csv(found, ranked).encode())
        note(f"wrote {options.output}")
    if options.markups:
        write_whole(options.markups, targets_markups_text(found, ranked).encode())
        note(f"wrote {options.markups}")
    if options.json:
        print_json(_record(anatomy, found, ranked, rank, breaths))
    else:
        print(one_line(anatomy.file.title or options.table))
        for line in _lines(found, ranked, rank, exact=options.exact_entry):
            print(one_line(line))
        for name, of_target in breaths.items():
            for line in breath_lines(of_target, f"{name}, entry 1: "):
                print(one_line(line))
        for topic, text in lattice_texts(_scenario(anatomy, found)).items():
            print(one_line(f"  {topic}: {text}"))
    if found.unreached:
        text = "that no path exists is not proved"
        if all(found.maps[name].impossible for name in found.unreached):
            text = "proved for the voxels of the file, the whole entry region and the cone"
        listed = ", ".join(found.unreached)
        return complain(f"no entry reaches {listed} in 0.1 % of executions by the table; {text}")
    return 0 if ranked else complain("no entry reaches all targets in 0.1 % of executions by the tables")


def _in_breath(anatomy: Anatomy, found: TargetMap, ranked: Sequence[TargetEntry]) -> dict[str, list[ResidualSuccess]]:
    """Return the success of the best entry with residuals of breathing, by target; empty without `[breathing]`."""
    from needleplan.planning import success_in_breath

    if not ranked or anatomy.file.breathing is None:
        return {}
    poses = {name: each.poses[[ranked[0].number]] for name, each in found.maps.items()}
    return {name: success_in_breath(found.maps[name].table, anatomy, pose) for name, pose in poses.items()}


def _scenario(anatomy: Anatomy, found: TargetMap) -> Any:
    """Return the scenario of the first target, with the title of the anatomy."""
    scenario = next(iter(found.maps.values())).table.scenario
    return replace(scenario, file=replace(scenario.file, title=anatomy.file.title))


def _states(found: TargetMap) -> tuple[int, float]:
    """Return the number of states of all tables, and the seconds of their solves."""
    stats = [each.stats for each in found.maps.values()]
    return sum(each["states"] for each in stats), sum(each["seconds"] for each in stats)


def _lines(found: TargetMap, ranked: Sequence[TargetEntry], rank: str, *, exact: bool) -> Iterator[str]:
    """Yield the lines of the ranked list: for each entry a line for all targets, and one for each insertion."""
    count, (states, seconds) = len(found.names), _states(found)
    yield (
        f"  {len(found.cost)} entry points, {count} targets, one insertion for each from the same entry point; "
        f"{states:,} states in {seconds:.1f} s"
    )
    yield from (f"  {limit}" for limit in found.limits)
    words = {"expected": "the expected number of targets reached", "all": "the probability that all are reached"}
    error = "" if exact else ", with an error of the entry"
    yield (
        f"  success by {found.runs:,} executions of each insertion; ordered by "
        f"{words.get(rank, f'the success for {rank}')}{error}; insertions: the most certain target first"
    )
    width = max(len(name) for name in found.names)
    for place, each in enumerate(ranked, start=1):
        low, high = each.expected_interval
        at = ", ".join(f"{x:.1f}" for x in each.position_mm)
        score = f"{each.score:.2f} of {count}" if rank == "expected" else percent(each.score)
        yield (
            f"  {place:>4}  {score}; as planned {each.expected_number:.2f} of {count} ({low:.2f} - {high:.2f}), all "
            f"{percent(each.reached_all)}, before a failure {each.expected_before_failure:.2f}; entry R, A, S {at}"
        )
        for number, (name, one) in enumerate(each.targets.items(), start=1):
            low, high = one.success.interval or (0.0, 1.0)
            missed = "" if one.reached else "  (its path without noise misses)"
            along = ", ".join(f"{x:.3f}" for x in one.direction)
            yield (
                f"        {number:>2}  {name:<{width}}  {percent(one.success.value):>7}  {percent(low):>6} - "
                f"{percent(high):>6}  {one.clearance_mm:>6.1f} mm  {one.length_mm:>3.0f} mm  {one.turns:>2} turns  "
                f"direction {along}{missed}"
            )


def _record(
    anatomy: Anatomy,
    found: TargetMap,
    ranked: Sequence[TargetEntry],
    rank: str,
    breaths: dict[str, list[ResidualSuccess]],
) -> dict[str, Any]:
    from needleplan.anatomy import obstacle_distances
    from needleplan.cli.table_poses import poses_of
    from needleplan.planning import SpacePose

    states, seconds = _states(found)
    is_impossible = any(each.impossible for each in found.maps.values())
    entries = []
    for each in ranked:
        record = each.record()
        if anatomy.file.anatomy.entries:
            record["entry_region"] = anatomy.entry_name(each.position_mm)
        for name, of_target in record["targets"].items():
            target = found.maps[name]
            pose = SpacePose(*target.poses[each.number].tolist())
            of_target["start"] = poses_of(target.table).record(pose)
            of_target["obstacles_mm"] = obstacle_distances(anatomy, target.path_mm(each.number))
            if breaths and each is ranked[0]:
                of_target["breathing"] = [residual.record(0) for residual in breaths[name]]
        entries.append(record)
    return {
        "title": anatomy.file.title,
        "answer": "impossible" if is_impossible else "not decided" if found.unreached else "possible",
        "targets": list(found.names),
        "unreached": found.unreached,
        "rank": rank,
        "entry_points": len(found.cost),
        "limits": [asdict(limit) for limit in found.limits],
        "states": states,
        "seconds": seconds,
        "runs": found.runs,
        "lattice": lattice_record(_scenario(anatomy, found)),
        "entries": entries,
    }


def _csv(found: TargetMap, ranked: Sequence[TargetEntry]) -> str:
    """Return the entry map as CSV, in RAS: a row for each entry point and target, the ranked ones in their order.

    The others follow by the expected number by the tables. `insertion` is the place of a target in the order.
    """
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(
        ["r_mm", "a_mm", "s_mm", "target", "insertion", "direction_r", "direction_a", "direction_s", "success",
         "success_low", "success_high", "success_source", "success_runs", "table_success", "cost", "clearance_mm",
         "length_mm", "turns", "reached", "expected_number", "reached_all", "rank"]
    )  # fmt: skip
    listed = {each.number: each for each in ranked}
    ranks = {number: rank for rank, number in enumerate(listed, start=1)}
    scores, products = found.scores("expected"), found.scores("all")
    others = (int(number) for number in (-scores).argsort(kind="stable") if int(number) not in listed)
    for number in (*listed, *others):
        entry = listed.get(number)
        of_table = found.success[:, number]
        order = list(entry.targets) if entry else [found.names[at] for at in (-of_table).argsort(kind="stable")]
        whole = (entry.expected_number, entry.reached_all) if entry else (scores[number], products[number])
        for place, name in enumerate(order, start=1):
            each = found.maps[name]
            frame, pose, paths = each.grid.frame, each.poses[number], each.paths
            success = entry.targets[name].success if entry else each.known_success(number)
            interval = [f"{end:.6g}" for end in success.interval or ()] or ["", ""]
            at = [f"{x:.6g}" for x in frame.world(pose[:3])]
            along = [f"{x:.6g}" for x in pose[3:] @ frame.axes]
            of_path = (each.success[number], each.value[number], paths.clearance_mm[number], paths.length_mm[number])
            rows.writerow(
                [*at, name, place, *along, f"{success.value:.6g}", *interval, success.source, success.runs,
                 *(f"{x:.6g}" for x in of_path), int(paths.turns[number]), int(paths.reached[number]),
                 *(f"{x:.6g}" for x in whole), ranks.get(number, "")]
            )  # fmt: skip
    return text.getvalue()
