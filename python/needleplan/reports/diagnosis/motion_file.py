"""The next motion as an experiment file for `needleplan simulate`."""

from __future__ import annotations

from textwrap import wrap

from needleplan.config import toml_text
from needleplan.diagnosis import Dwell, Insert, Program, Rotate
from needleplan.models import Model
from needleplan.signals import Role
from needleplan.simulation import Experiment

__all__ = ["motion_text"]

_HEAD = """\
The next motion to measure: {about}.
{why}

In the lab twin:   needleplan simulate {file} -o next.csv
On the robot:      each [[move]] is one call of Stage.insert or Stage.rotate; start the next call when the stage is at
                   rest (docs/reference/diagnosis.md). Start with the tip at entry.depth_mm below the surface.
Give the trial the role {role}, and diagnose again with all recordings.
"""
# Longest line of the comment at the head of the file, in characters.
_WIDTH = 117


def motion_text(program: Program, why: str, role: Role, model: Model, file: str = "next_motion.toml") -> str:
    """Return the text of an experiment file with the moves of a program.

    `why`, `role` and the name of the `file` stand in its comment. The curvature and cutting force of the simulated
    tissue are those of `model`, or 0 if `model` has none.
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
    text = toml_text(document, _HEAD.format(about=program.about, why=words, role=role, file=file))
    Experiment.from_toml(text, file)  # raises if the file is invalid
    return text


def _move(move: Dwell | Insert | Rotate) -> dict[str, float]:
    """Return the keys and values of the TOML table of a move."""
    if isinstance(move, Dwell):
        return {"dwell_s": float(move.seconds)}
    if isinstance(move, Insert):
        return {"insert_to_mm": float(move.to_mm), "velocity_mm_s": float(move.velocity_mm_s)}
    return {"rotate_to_rad": float(move.to_rad), "velocity_rad_s": float(move.velocity_rad_s)}
