"""The next motion as an experiment file for `needleplan simulate`, and as an entry of `diagnosis.json`."""

from __future__ import annotations

from textwrap import wrap

from needleplan.config import toml_text
from needleplan.diagnosis.next_motion import (
    Dwell,
    Exploring,
    Insert,
    NextMotion,
    Program,
    Revealing,
    Rotate,
    Separating,
    Separation,
)
from needleplan.models import Model
from needleplan.signals import Role
from needleplan.simulation import Experiment

__all__ = ["motion_text", "next_motion_document"]

_HEAD = """\
The next motion to measure: {about}.
{why}

In the lab twin:   needleplan simulate next_motion.toml -o next.csv
On the robot:      each [[move]] is one call of Stage.insert or Stage.rotate; start the next call when the stage is at
                   rest (docs/reference/diagnosis.md). Start with the tip at entry.depth_mm below the surface.
Give the trial the role {role}, and diagnose again with all recordings.
"""
# Longest line of the comment at the head of the file, in characters.
_WIDTH = 117


def motion_text(program: Program, why: str, role: Role, model: Model) -> str:
    """Return the text of an experiment file with the moves of a program.

    `why` and `role` stand in its comment. The curvature and cutting force of the simulated tissue are those of `model`,
    or 0 if `model` has none.
    """
    limits = program.limits
    document = {
        "schema": "needleplan.experiment/1",
        "title": f"next motion: {program.name}",
        "entry": {"depth_mm": min(limits.shallowest_mm, 0.0)},
        "tissue": {
            "curvature_per_mm": float(getattr(model, "curvature_per_mm", 0.0)),
            "cutting_n": float(getattr(model, "cutting", 0.0)),
        },
        "robot": {
            "top_velocity_mm_s": max(limits.fastest_mm_s, 1.0),
            "acceleration_mm_s2": limits.acceleration_mm_s2,
            "deepest_mm": max(limits.deepest_mm, 0.0),
        },
        "move": [_move(each) for each in program.moves],
    }
    words = "\n".join(wrap(why, _WIDTH))
    text = toml_text(document, _HEAD.format(about=program.about, why=words, role=role))
    Experiment.from_toml(text, "next_motion.toml")  # raises if the file is invalid
    return text


def next_motion_document(next_: NextMotion) -> dict[str, object]:
    """Return the entry of the next motion in `diagnosis.json`, as a dictionary of JSON values."""
    found: dict[str, object] = {
        "name": next_.program.name,
        "about": next_.program.about,
        "why": next_.why,
        "role": str(next_.role),
        "file": "next_motion.toml",
        "duration_s": float(next_.motion.time_s[-1]),
    }
    match next_:
        case Separating():
            return found | {"purpose": "separate"} | _separating(next_)
        case Exploring():
            return found | {
                "purpose": "explore", "axis": str(next_.axis),
                "also": str(next_.also) if next_.also else None, "visited": list(next_.visited),
                "reach": list(next_.reach), "bits": next_.bits, "repeated_bits": next_.repeated_bits,
                "considered": [{"name": name, "bits": bits} for name, bits in next_.considered],
            }  # fmt: skip
        case Revealing():
            return found | {
                "purpose": "reveal", "shrinks_to": next_.shrinks_to, "repeated_shrinks_to": next_.repeated_shrinks_to,
                "effects": [
                    {"effect": each.effect, "unit": each.unit, "now": each.now, "after": each.after,
                     "repeated": each.repeated}
                    for each in next_.effects
                ],
                "considered": [{"name": name, "shrinks_to": share} for name, share in next_.considered],
            }  # fmt: skip
        case _:
            return found


def _separating(next_: Separating) -> dict[str, object]:
    return {
        "resolves": next_.resolves,
        "pairs": [_pair(each) for each in next_.separations],
        "repeated": {"resolves": next_.repeated_resolves, "pairs": [_pair(each) for each in next_.repeated]},
        "synonyms": [{"effects": [each.first, each.second], "trials": each.trials} for each in next_.synonyms],
        "considered": [
            {"name": name, "resolves": resolves, "least_thresholds": least}
            for name, resolves, least in next_.considered
        ],
    }


def _pair(each: Separation) -> dict[str, object]:
    return {
        "true": each.true, "rival": each.alternative, "lead": each.lead, "expected": each.expected,
        "thresholds": each.thresholds, "resolves": each.resolves,
    }  # fmt: skip


def _move(move: Dwell | Insert | Rotate) -> dict[str, float]:
    """Return the keys and values of the TOML table of a move."""
    if isinstance(move, Dwell):
        return {"dwell_s": float(move.seconds)}
    if isinstance(move, Insert):
        return {"insert_to_mm": float(move.to_mm), "velocity_mm_s": float(move.velocity_mm_s)}
    return {"rotate_to_rad": float(move.to_rad), "velocity_rad_s": float(move.velocity_rad_s)}
