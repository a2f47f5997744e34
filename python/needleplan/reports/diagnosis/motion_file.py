"""The next motions as simulation files for `needleplan simulate`, and what such a file cannot hold."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from textwrap import wrap

import numpy as np

from needleplan.config import toml_text
from needleplan.diagnosis import Dwell, Insert, NextTrials, Program, Rotate
from needleplan.errors import InputError
from needleplan.models import Model
from needleplan.signals import Limits, Record, Role
from needleplan.simulation import Shaft, Simulation

__all__ = ["MotionFile", "motion_files", "motion_problem", "motion_text"]

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


@dataclass(frozen=True)
class MotionFile:
    """Simulation file of a proposed motion: its name and text, or the problem because of which there is no file."""

    name: str
    text: str
    problem: str = ""


def motion_files(next_: NextTrials | None, model: Model) -> dict[str, MotionFile]:
    """Return the file of each proposed motion, by the name of the motion. A repetition of a recorded trial has none.

    A motion that a simulation file cannot hold has a problem and no text.
    """
    found: dict[str, MotionFile] = {}
    for motion in next_.motions if next_ else ():
        if next_ and motion.program and motion.name not in found:
            number = len(found) + 1
            file = f"next_motion{f'_{number}' if number > 1 else ''}.toml"
            try:
                found[motion.name] = MotionFile(file, motion_text(motion.program, next_.why, next_.role, model, file))
            except InputError as error:
                found[motion.name] = MotionFile(file, "", f"{error}")
    return found


def motion_problem(records: Sequence[Record], model: Model) -> str:
    """Return why no simulation file can hold the next motion, in the depths and at the speeds of the trials.

    Empty if one can. Called before the diagnosis, whose answer does not depend on it.
    """
    trials = [record for record in records if "depth_mm" in record.columns and record.role is not Role.NOISE]
    depths = np.concatenate([record["depth_mm"] for record in trials] or [np.zeros(0)])
    speeds = np.concatenate(
        [np.abs(record["velocity_mm_s"]) for record in trials if "velocity_mm_s" in record.columns] or [np.zeros(0)]
    )
    depths, speeds = depths[np.isfinite(depths)], speeds[np.isfinite(speeds)]
    if not depths.size:
        return ""
    try:
        limits = Limits(float(depths.max()), max(float(speeds.max(initial=0.0)), Limits.fastest_mm_s))
        moves = (Insert(limits.deepest_mm, limits.fastest_mm_s),)
        motion_text(Program("check", "the deepest and fastest motion", moves, limits), "", Role.TRAIN, model)
    except InputError as error:
        return f"{error}"
    return ""


def motion_text(program: Program, why: str, role: Role, model: Model, file: str = "next_motion.toml") -> str:
    """Return the text of a simulation file with the moves of a program.

    `why`, `role` and the name of the `file` stand in its comment. The curvature and cutting force of the simulated
    tissue are those of `model`, or 0 if `model` has none.
    """
    limits = program.limits
    deep = limits.deepest_mm > Shaft().length_mm  # the recorded needle is longer than that of the lab twin
    document = {
        "schema": "needleplan.simulation/1",
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
        **({"shaft": {"length_mm": float(math.ceil(limits.deepest_mm))}} if deep else {}),
        "move": [_move(move) for move in program.moves],
    }
    words = "\n".join(wrap(why, _WIDTH))
    text = toml_text(document, _HEAD.format(about=program.about, why=words, role=role, file=file))
    Simulation.from_toml(text, file)  # raises if the file is invalid
    return text


def _move(move: Dwell | Insert | Rotate) -> dict[str, float]:
    """Return the keys and values of the TOML table of a move."""
    if isinstance(move, Dwell):
        return {"dwell_s": float(move.seconds)}
    if isinstance(move, Insert):
        return {"insert_to_mm": float(move.to_mm), "velocity_mm_s": float(move.velocity_mm_s)}
    return {"rotate_to_rad": float(move.to_rad), "velocity_rad_s": float(move.velocity_rad_s)}
