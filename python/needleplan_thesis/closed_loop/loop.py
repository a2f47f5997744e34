"""One round of the closed loop: plan, insert, diagnose recordings, plan with the diagnosed model, insert again.

The lab twin has a hidden effect that the first plan does not contain, so the first insertions miss. Recordings of a few
insertions into the same tissue are diagnosed. While the verdict is AMBIGUOUS or INCOMPLETE, the proposed next motion is
recorded and all recordings are diagnosed again. The second plan uses the diagnosed model. Insertions follow the moves
of their plan without feedback, because feedback would compensate for the missing effect.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial

from needleplan.diagnosis import Diagnosis, Library, Verdict, diagnose, next_trials
from needleplan.models import Channel, Estimate, SpatialBicycle
from needleplan.models.effects import effects_of
from needleplan.planning import PolicyTable, plan
from needleplan.reports.diagnosis import CorrectedPlan, along_mm, corrected_plan, motion_text
from needleplan.scenario import Scenario
from needleplan.signals import Record, Role
from needleplan.simulation import Plant, SimulatedEntry, Simulation
from needleplan_thesis.closed_loop.hidden import (
    NOTHING,
    SHAFT,
    HiddenEffect,
    hidden_named,
    laboratory,
    next_record,
    recorded_moves,
    recordings,
)
from needleplan_thesis.processes import map_in_processes
from needleplan_thesis.steering import execute_moves, path_end, planned_moves

__all__ = ["VELOCITY_MM_S", "NamedEffect", "OpenLoopInsertion", "Round", "diagnosed", "run_round", "run_rounds"]

VELOCITY_MM_S = 10.0
"""Insertion velocity when a plan is executed (mm/s)."""

_VELOCITY_RAD_S = 10.0
"""Speed of rotations when a plan is executed (rad/s)."""

_MORE = 2
"""Largest number of next motions in a round."""

# First seed of the recordings, and seeds per round.
_RECORDED_FROM = 10_000
_SEEDS_PER_ROUND = 100


@dataclass(frozen=True)
class OpenLoopInsertion:
    """Predicted and realised success of an insertion, and distance (mm) of its end from the target centre in 3D."""

    predicted: float
    success: bool
    error_mm: float


@dataclass(frozen=True)
class NamedEffect:
    """An effect that a diagnosis names, with its estimated parameters."""

    name: str
    estimates: dict[str, Estimate]


@dataclass(frozen=True)
class Round:
    """Results of one round, with one insertion for each seed.

    - `verdicts`: verdict of each diagnosis, the first one and one after each recorded next motion
    - `motions`: names of the recorded next motions
    - `named`: effects that the last diagnosis names; empty if its verdict is not NAMED
    - `before`, `after`: insertions by the first plan, and by the plan with the diagnosed model
    """

    hidden: str
    seeds: tuple[int, ...]
    verdicts: tuple[Verdict, ...]
    motions: tuple[str, ...]
    named: tuple[NamedEffect, ...]
    before: tuple[OpenLoopInsertion, ...]
    after: tuple[OpenLoopInsertion, ...]
    known: tuple[OpenLoopInsertion, ...]
    """Insertions by the first plan in a lab without a hidden effect: the error due to scatter alone."""


def run_round(hidden: HiddenEffect, scenario: Scenario, seeds: Sequence[int]) -> Round:
    """Run one round and return its results. Each seed gives one insertion; the first also gives the recordings."""
    found, motions = diagnosed(hidden, scenario, seeds[0])
    last = found[-1]
    wrong = corrected_plan(_base(scenario), scenario, velocity_mm_s=VELOCITY_MM_S)
    right = corrected_plan(
        last.model, scenario, velocity_mm_s=VELOCITY_MM_S, stiffness_n_mm2=SHAFT.torsional_stiffness_n_mm2,
        shaft_mm=SHAFT.length_mm, places=along_mm(last.checked.training),
    )  # fmt: skip
    effects = last.effects if last.verdict is Verdict.NAMED else ()
    return Round(
        hidden.name,
        tuple(seeds),
        tuple(each.verdict for each in found),
        motions,
        tuple(NamedEffect(effect.name, dict(effect.estimates)) for effect in effects),
        *(
            tuple(_inserted(lab, known, scenario, seed) for seed in seeds)
            for lab, known in ((hidden, wrong), (hidden, right), (NOTHING, wrong))
        ),
    )


def diagnosed(hidden: HiddenEffect, scenario: Scenario, seed: int) -> tuple[list[Diagnosis], tuple[str, ...]]:
    """Record and diagnose; return all diagnoses of a round, and the names of the next motions recorded in between."""
    setup = hidden.hide(laboratory(scenario))
    first = _RECORDED_FROM + _SEEDS_PER_ROUND * seed
    data = recordings(setup, first)
    found = [_diagnose(scenario, data)]
    motions: list[str] = []
    taken = dict(zip((each.trial for each in data), recorded_moves(), strict=False))
    while found[-1].verdict in (Verdict.AMBIGUOUS, Verdict.INCOMPLETE) and len(motions) < _MORE:
        wanted = next_trials(found[-1])
        if wanted is None:
            break
        (motion,), seed = wanted.motions, first + len(data)
        if motion.program:
            text = motion_text(motion.program, wanted.why, wanted.role, found[-1].base)
            taken[f"{Role.TRAIN} {seed}"] = 0.0, Simulation.from_toml(text).moves
        else:
            taken[f"{Role.TRAIN} {seed}"] = taken[motion.repeats]
        data.append(next_record(setup, *taken[f"{Role.TRAIN} {seed}"], seed))
        motions.append(motion.name if motion.program else "repetition")
        found.append(_diagnose(scenario, data))
    return found, tuple(motions)


def _diagnose(scenario: Scenario, data: Sequence[Record]) -> Diagnosis:
    return diagnose(_base(scenario), data, library=_library(scenario))


def _base(scenario: Scenario) -> SpatialBicycle:
    return SpatialBicycle(curvature_per_mm=1 / scenario.needle.curvature_radius_mm)


@lru_cache(maxsize=1)
def _library(scenario: Scenario) -> Library:
    """Return the library of effects. It is cached, because it stores computations that all seeds share."""
    return Library(effects_of(Channel.TIP), _base(scenario))


def _inserted(hidden: HiddenEffect, known: CorrectedPlan, scenario: Scenario, seed: int) -> OpenLoopInsertion:
    table = _planned(known.scenario)
    start = table.best_entry().pose
    entry = SimulatedEntry(start.x_mm, start.y_mm, start.heading_rad - known.heading_rad)
    setup = hidden.hide(laboratory(scenario, entry))
    path = execute_moves(
        Plant(setup, seed), planned_moves(table, start), VELOCITY_MM_S, _VELOCITY_RAD_S, known.torsion,
        known.bends.roll_rad,
    )  # fmt: skip
    end = path_end(scenario, path)
    success = not (end.touched or end.left) and end.distance_mm <= scenario.target.radius_mm
    return OpenLoopInsertion(float(table.lookup(*start).success), success, end.distance_mm)


@lru_cache(maxsize=4)
def _planned(scenario: Scenario) -> PolicyTable:
    return plan(scenario)


_SHARING = 5
"""Number of insertions that share a diagnosis, because a diagnosis takes longer than five insertions."""


def run_rounds(
    scenario: Scenario, hidden: Sequence[HiddenEffect], seeds: Sequence[int], processes: int = 1
) -> Iterator[Round]:
    """Yield the rounds of all hidden effects in order.

    Up to five seeds form one round and share its recordings and diagnosis.
    """
    groups = [tuple(seeds[first : first + _SHARING]) for first in range(0, len(seeds), _SHARING)]
    tasks = [(each.name, group) for each in hidden for group in groups]
    yield from map_in_processes(partial(_round, scenario), tasks, processes)


def _round(scenario: Scenario, task: tuple[str, tuple[int, ...]]) -> Round:
    name, seeds = task
    return run_round(hidden_named(name), scenario, seeds)
