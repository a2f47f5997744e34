"""The next motion as an experiment file: `needleplan simulate` runs it, and a robot can follow its moves."""

from __future__ import annotations

import json
from collections.abc import Iterator

from needleplan.diagnosis.next_motion import NextMotion, Separation
from needleplan.diagnosis.program import Dwell, Insert, Program
from needleplan.models import Model
from needleplan.simulation import Experiment

__all__ = ["motion_text", "next_motion_document"]

_HEAD = """\
# The next motion to be measured: {about}.
# {why}
#
# In the lab twin:   needleplan simulate next_motion.toml -o next.csv
# On the robot:      each [[move]] is one call of Stage.insert or Stage.rotate, and the next one begins when the stage
#                    rests (docs/reference/diagnosis.md); begin with the tip at entry.depth_mm below the surface.
# Give the trial the role train, and diagnose again with all recordings.
"""


def motion_text(next_: NextMotion, model: Model) -> str:
    """Return the text of an experiment file with the moves of a motion, in the tissue as far as `model` knows it."""
    program, limits = next_.program, next_.program.limits
    least = min(next_.separations, key=lambda each: each.thresholds)
    again = min(each.thresholds for each in next_.repeated)
    why = (
        f"It should move the balance of {least.true} and {least.rival} by {least.thresholds:.1f} times the lead that a "
        f"name needs; the last motion again: {again:.1f} times."
    )
    lines = [
        'schema = "needleplan.experiment/1"',
        f"title = {json.dumps(f'next motion: {program.name}')}",
        "",
        "[entry]",
        f"depth_mm = {min(limits.shallowest_mm, 0.0)!r}",
        "",
        "[tissue]",
        f"curvature_per_mm = {float(getattr(model, 'curvature_per_mm', 0.0))!r}",
        f"cutting_n = {float(getattr(model, 'cutting', 0.0))!r}",
        "",
        "[robot]",
        f"top_velocity_mm_s = {max(limits.fastest_mm_s, 1.0)!r}",
        f"acceleration_mm_s2 = {limits.acceleration_mm_s2!r}",
        f"deepest_mm = {max(limits.deepest_mm, 0.0)!r}",
        *_moves(program),
    ]
    text = _HEAD.format(about=program.about, why=why) + "\n".join(lines) + "\n"
    Experiment.from_toml(text, "next_motion.toml")  # what is offered can be run
    return text


def next_motion_document(next_: NextMotion) -> dict[str, object]:
    """Return what diagnosis.json says of it."""
    return {
        "name": next_.program.name,
        "about": next_.program.about,
        "file": "next_motion.toml",
        "duration_s": float(next_.motion.time_s[-1]),
        "resolves": next_.resolves,
        "pairs": [_pair(each) for each in next_.separations],
        "repeated": {"resolves": next_.repeated_resolves, "pairs": [_pair(each) for each in next_.repeated]},
        "considered": [
            {"name": name, "resolves": resolves, "least_thresholds": least}
            for name, resolves, least in next_.considered
        ],
    }


def _pair(each: Separation) -> dict[str, object]:
    return {
        "true": each.true, "rival": each.rival, "lead": each.lead, "expected": each.expected,
        "thresholds": each.thresholds, "resolves": each.resolves,
    }  # fmt: skip


def _moves(program: Program) -> Iterator[str]:
    for move in program.moves:
        yield from ("", "[[move]]")
        if isinstance(move, Dwell):
            yield f"dwell_s = {float(move.seconds)!r}"
        elif isinstance(move, Insert):
            yield from (f"insert_to_mm = {float(move.to_mm)!r}", f"velocity_mm_s = {float(move.velocity_mm_s)!r}")
        else:
            yield from (f"rotate_to_rad = {float(move.to_rad)!r}", f"velocity_rad_s = {float(move.velocity_rad_s)!r}")
