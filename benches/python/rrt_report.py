"""The report and the figure of `compare_planners.py`."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from statistics import mean, median
from typing import Any

import numpy as np
from rrt_arcs import Array, advance
from rrt_scenes import GOAL_TOLERANCE_MM, MARGIN_MM, RADIUS_MM, SIDE_MM, Scene

Result = Mapping[str, Any]
Record = Mapping[str, Any]
# Smallest success probability at the start that a solved scene without noise shall have.
WANTED = 0.95


def text(record: Record) -> str:
    """Return the report as Markdown."""
    parts = ["# Policy tables beside a kinodynamic RRT", _heading(record)]
    parts += ["## Summary", "\n".join(_summary(record))]
    parts += ["## Is a solved scene certain?", _certain(record)]
    parts += ["## Scenes that nobody solved", _unsolved(record)]
    parts += ["## Every scene", "\n".join(_paths(record)), "\n".join(_noise(record))]
    return "\n\n".join(parts)


def by_table(result: Result) -> bool:
    """Whether the policy without noise reaches the target, by the exact simulation."""
    return bool(result["table"]["event"] == "target")


def by_finer(result: Result) -> bool:
    """Whether the policy with the finer headings reaches the target without noise, by the exact simulation."""
    return bool(result["finer"]["event"] == "target")


def is_solved(result: Result) -> bool:
    """Whether any planner reaches the target without noise."""
    return by_table(result) or by_finer(result) or by_rrt(result)


def by_rrt(result: Result) -> bool:
    """Whether at least one run of RRT found a path that reaches the target, by the exact simulation."""
    return bool(result["rrt"]["solved"])


def _heading(record: Record) -> str:
    about = record["machine"]
    versions = ", ".join(f"{name} {number}" for name, number in about["packages"].items())
    odds = ", ".join(f"{each:g}" for each in record["tip_noise"])
    return (
        f"{len(record['scenes'])} scenes of {SIDE_MM:g} x {SIDE_MM:g} mm, radius {RADIUS_MM:g} mm, margin "
        f"{MARGIN_MM:g} mm, goal tolerance {GOAL_TOLERANCE_MM:g} mm. Tables: {record['headings']} headings "
        f"(a second one without noise: {record['finer_headings']}), grid of {record['spacing_mm']:g} mm, interpolated, "
        f"one thread. RRT: OMPL, {len(record['rrt_seeds'])} seeds, at most "
        f"{record['limit']:,} propagations each; the figures of a path are those of the first seed that solves. "
        f"Noise: [{odds}] after each step, {record['runs']:,} executions. Times are processor times; RRT calls the "
        f"needle's model in Python.\n\n"
        f"{about['processor']}, load {about['load_before']} before the run; {about['date'][:10]}, "
        f"commit {about['commit']}, Python {about['python']}, {versions}."
    )


def _summary(record: Record) -> list[str]:
    results = record["scenes"]
    both = [each for each in results if by_table(each) and by_finer(each) and by_rrt(each)]
    lines = [
        f"| | table | table, {record['finer_headings']} headings | RRT |",
        "|---|--:|--:|--:|",
        f"| solved, of {len(results)} | {sum(map(by_table, results))} | {sum(map(by_finer, results))} | "
        f"{sum(map(by_rrt, results))} |",
    ]
    if both:
        times = [median(each[name]["seconds"] for each in both) for name in ("table", "finer")]
        search = median(_search_s(each) for each in both)
        lines += [
            f"| time, median, s (RRT: search only) | {times[0]:.2f} | {times[1]:.2f} | {search:.2f} |",
            _row("length, median, mm", both, "length_mm", median, "{:.0f}"),
            _row("turns, median", both, "turns", median, "{:.0f}"),
            _row("clearance, median, mm", both, "clearance_mm", median, "{:.1f}"),
            f"| success with noise, mean | {_mean(both, 'table', 'realised_with_noise')} (closed loop) | | "
            f"{_mean(both, 'rrt', 'open_loop')} (open loop), {_mean(both, 'rrt', 'following')} (following the path) |",
        ]
        lines.append(f"\nAll rows but the first: the {len(both)} scenes that all three solved.")
    off = [each["table"]["predicted_with_noise"] - each["table"]["realised_with_noise"] for each in results]
    lines.append(
        f"Success of the table with noise, predicted minus realised, over all scenes: mean {100 * mean(off):+.1f} "
        f"points, mean absolute {100 * mean(map(abs, off)):.1f}, worst {100 * max(off, key=abs):+.1f}."
    )
    return lines


def _certain(record: Record) -> str:
    results = record["scenes"]
    solved = [each for each in results if is_solved(each)]
    broken = {name: [each for each in solved if _success(each, name) < WANTED] for name in ("table", "finer")}
    lines = [
        f"Wanted: a scene that any of the planners solves has a table success of at least {WANTED:g} at its start, "
        f"without noise. This holds for {len(solved) - len(broken['table'])} of {len(solved)} scenes with "
        f"{record['headings']} headings, and for {len(solved) - len(broken['finer'])} with {record['finer_headings']}.",
    ]
    listed = [each for each in solved if each in broken["table"] or each in broken["finer"]]
    if listed:
        both = record["headings"], record["finer_headings"]
        titles = " | ".join(f"{count} headings: success | path" for count in both)
        lines += ["", f"| violation | {titles} | RRT |", "|---|--:|---|--:|---|---|"]
    for each in listed:
        cells = [f"{_success(each, name):.3f} | {each[name]['event']}" for name in ("table", "finer")]
        rrt = each["rrt"]
        lines.append(f"| {each['scene']['name']} | {' | '.join(cells)} | {rrt['solved']} of {len(rrt['tries'])} |")
    false = [
        each["scene"]["name"]
        for each in results
        if any(_success(each, name) >= WANTED and each[name]["event"] != "target" for name in ("table", "finer"))
    ]
    refuted = sum(each["rrt"]["refuted"] for each in results)
    lines += [
        "",
        f"Scenes with such a table success whose executed path fails: {', '.join(false) or 'none'}.",
        f"Paths of RRT that the exact test refuted: {refuted}.",
    ]
    return "\n".join(lines)


def _success(result: Result, name: str) -> float:
    return float(result[name]["success_at_start"])


def _unsolved(record: Record) -> str:
    unsolved = [each for each in record["scenes"] if not is_solved(each)]
    wrong = [each["scene"]["name"] for each in record["scenes"] if each["proof"]["infeasible"] and each not in unsolved]
    lines = ["| scene | table success | solution | finest cells |", "|---|--:|---|---|"] if unsolved else ["None."]
    for each in unsolved:
        proof, success = each["proof"], each["table"]["success_at_start"]
        answer = "none exists (proven)" if proof["infeasible"] else "open"
        last = proof["levels"][-1]
        cells = f"{last['cell_mm']:g} mm, {last['headings']} headings"
        lines.append(f"| {each['scene']['name']} | {success:.3f} | {answer} | {cells} |")
    lines.append(
        f"\nSolved scenes that the coarsest grid calls infeasible (must be none): {', '.join(wrong) or 'none'}."
    )
    return "\n".join(lines)


def _paths(record: Record) -> list[str]:
    lines = [
        "Without noise:",
        "",
        f"| scene | table | success | mm | turns | clearance | s | {record['finer_headings']} headings | "
        "success | RRT | mm | turns | clearance | search s |",
        "|---|---|--:|--:|--:|--:|--:|---|--:|---|--:|--:|--:|--:|",
    ]
    for each in record["scenes"]:
        table, rrt = each["table"], each["rrt"]
        mine = _figures(table) if by_table(each) else " | | "
        other = _figures(rrt) if by_rrt(each) else " | | "
        lines.append(
            f"| {each['scene']['name']} | {table['event']} | {table['success_at_start']:.3f} | {mine} | "
            f"{table['seconds']:.2f} | {each['finer']['event']} | {_success(each, 'finer'):.3f} | "
            f"{rrt['solved']} of {len(rrt['tries'])} | {other} | {_search_s(each):.2f} |"
        )
    return lines


def _noise(record: Record) -> list[str]:
    lines = [
        "With noise, share of the executions that reach the target:",
        "",
        "| scene | table, predicted | table, realised | turns | RRT, open loop | RRT, following |",
        "|---|--:|--:|--:|--:|--:|",
    ]
    for each in record["scenes"]:
        table, rrt = each["table"], each["rrt"]
        other = f"{_percent(rrt['open_loop'])} | {_percent(rrt['following'])}" if by_rrt(each) else " | "
        lines.append(
            f"| {each['scene']['name']} | {_percent(table['predicted_with_noise'])} | "
            f"{_percent(table['realised_with_noise'])} | {table['turns_with_noise']:.1f} | {other} |"
        )
    return lines


def _figures(path: Result) -> str:
    return f"{path['length_mm']:.0f} | {path['turns']} | {path['clearance_mm']:.1f}"


def _search_s(result: Result) -> float:
    return float(median(each["search_s"] for each in result["rrt"]["tries"]))


def _row(name: str, results: Sequence[Result], key: str, of: Callable[[Any], float], form: str) -> str:
    cells = [form.format(of([each[planner][key] for each in results])) for planner in ("table", "finer", "rrt")]
    return f"| {name} | {' | '.join(cells)} |"


def _mean(results: Sequence[Result], planner: str, key: str) -> str:
    return _percent(mean(each[planner][key] for each in results))


def _percent(share: float) -> str:
    return f"{100 * share:.1f} %"


def draw(record: Record, file: Path) -> None:
    """Draw every scene with the paths of both planners."""
    from matplotlib.figure import Figure

    results = record["scenes"]
    columns = min(7, len(results))
    rows = -(-len(results) // columns)
    figure = Figure(figsize=(2.1 * columns, 2.25 * rows), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for ax in axes:
        ax.set_axis_off()
    for ax, each in zip(axes, results, strict=False):
        _draw_scene(ax, each)
    figure.savefig(file, dpi=110)


def _draw_scene(ax: Any, result: Result) -> None:
    scene = Scene.from_json(result["scene"])
    for polygon in scene.inflated:
        ax.fill(*np.array(polygon).T, color="0.85")
    for polygon in scene.obstacles:
        ax.fill(*np.array(polygon).T, color="0.55")
    for planner, colour in (("rrt", "tab:orange"), ("table", "tab:blue")):
        if "arcs" in result[planner]:
            line = _line(scene, result[planner]["arcs"], result[planner]["length_mm"])
            ax.plot(*line.T[:2], color=colour, linewidth=1.2)
    ax.plot(*scene.target, "o", color="tab:green", markersize=4)
    ax.set(xlim=(-1, SIDE_MM + 1), ylim=(-1, SIDE_MM + 1), aspect="equal")
    solved = {"table": by_table(result), "finer table": by_finer(result), "RRT": by_rrt(result)}
    who = ", ".join(name for name, does in solved.items() if does) or "nobody"
    ax.set_title(scene.name + ("" if all(solved.values()) else f": {who}"), fontsize=7)
    ax.set_axis_on()
    ax.set(xticks=[], yticks=[])


def _line(scene: Scene, arcs: Sequence[tuple[int, float]], longest: float) -> Array:
    pose, line, left = np.array([scene.start]), [np.array([scene.start])], longest
    for bevel, length in arcs:
        part = min(length, left)
        left -= part
        along = np.linspace(0, part, 20)
        line.append(advance(np.repeat(pose, 20, axis=0), np.full(20, float(bevel)), along))
        pose = line[-1][-1:]
    return np.concatenate(line)
