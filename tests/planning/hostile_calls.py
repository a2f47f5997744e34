"""Calls of the compiled module and of the public planning functions with arguments that nobody should pass.

    python tests/planning/hostile_calls.py SEED COUNT

Every call has good arguments, of which one to three are replaced. It must return, or raise a documented exception, in
`LIMIT_S`; a longer call is ended by a signal, as by Ctrl-C, and must then end soon. A panic, an abort, another
exception or a hang ends the program with a message that names the call.
"""

import contextlib
import faulthandler
import math
import random
import resource
import signal
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

import needleplan as npl
from needleplan import _ppvi

# Time (s) after which a call is interrupted, and after which one that ignores this ends the program.
LIMIT_S, HANGS_S = 2.0, 60.0

# Address space (bytes) of the program: larger allocations fail instead of filling the machine.
MEMORY_BYTES = 12 << 30

SCALARS: tuple[Any, ...] = (
    None, True, False, 0, 1, -1, 2, 3, 7, 2**31, 2**32 - 1, 2**32, 2**53, 2**62, 2**63, 2**64 - 1, 2**64, 2**70,
    -(2**63), -(2**70), 0.0, -0.0, 0.5, 1.5, -0.5, math.nan, math.inf, -math.inf, 5e-324, 1e-300, 1e-9, 1e9, 1e100,
    1e300, "", "a", "nan", "1", b"1", (), [], {}, [1], [math.nan], [[1.0]], [None], "H2", "sweep", 1j, object(),
    np.float32(1), np.int8(-1), np.array(1.0), np.array([]), np.datetime64("2026-01-01"), range(3), Path("nowhere"),
    np.str_("a"),
)  # fmt: skip


class Overtime(Exception):
    """The call was interrupted by the timer."""


@dataclass(frozen=True)
class Door:
    """A function, its good arguments, and the exceptions that it documents."""

    name: str
    call: Callable[..., object]
    good: dict[str, Any]
    documented: tuple[type[BaseException], ...]


RAW = (ValueError, TypeError, OverflowError, MemoryError)
PUBLIC = (npl.NeedleplanError,)

LATTICE: dict[str, Any] = {
    "width_mm": 30.0, "height_mm": 22.0, "spacing_mm": (2.0, 2.0),
    "obstacles": [([[(5.0, 5.0), (10.0, 5.0), (8.0, 10.0)]], 0.0)],
    "target_center_mm": (24.0, 12.0), "target_radius_mm": 3.0,
    "curvature_radius_mm": 6.0, "headings": 8, "tip_noise": [0.5, 0.25], "arc_samples": 2, "interpolated": True,
    "insertion_per_mm": 1.0, "rotation": 1.0, "collision": 1e3, "exit": 1e3, "discount": 1.0,
    "clearance_mm": 1.0, "clearance_per_mm": 0.5, "layers": [(5.0, 8.0)],
    "tissues": [([[(12.0, 12.0), (20.0, 12.0), (20.0, 20.0)]], 0.0, 7.0)],
}  # fmt: skip
LIMITS = {"max_sweeps": 30, "time_limit_s": 0.5, "threads": 1, "progress": None}
ROWS: dict[str, Any] = {
    "action_offsets": np.array([0, 2, 3, 3]), "row_offsets": np.array([0, 1, 3, 4]),
    "successors": np.array([1, 0, 2, 2], dtype=np.uint32), "probabilities": np.array([1.0, 0.5, 0.5, 1.0]),
    "stage_costs": np.array([1.0, 2.0, 1.0]), "discount": 0.9,
}  # fmt: skip
SCENARIO = """schema = "needleplan.scenario/1"
[workspace]
width_mm = 30.0
height_mm = 22.0
[target]
center_mm = [24, 12]
radius_mm = 3
[needle]
curvature_radius_mm = 6
[motion]
headings = 8
[grid]
spacing_mm = [2.0, 2.0]
"""


def doors() -> list[Door]:
    """Return all functions under test; files go to the current folder."""
    lattice = _ppvi.Lattice(**LATTICE)
    solved = lattice.solve(method="sweep", partitions=(2, 2), priority="H2", tolerance=0.1)
    policy, values = solved["policy"], solved["values"]
    rows = _ppvi.Tabular(**ROWS)
    table = npl.plan(npl.Scenario.from_toml(SCENARIO))
    scenario, mdp = table.scenario, npl.mdp.TabularMdp.from_rows(**ROWS)
    start = npl.Pose(2.0, 12.0, 0.0, 1)
    starts = np.array([[2.0, 12.0, 0.0, 1.0], [4.0, 12.0, 0.1, -1.0]])
    plan_parts = {
        name: {each: getattr(getattr(scenario, name), each) for each in vars(getattr(scenario, name))}
        for name in ("workspace", "target", "needle", "motion", "grid", "objective", "solver")
    }

    def plan_of(part: str) -> Callable[..., object]:
        def plan(**fields: Any) -> object:
            changed = replace(scenario, **{part: type(getattr(scenario, part))(**fields)})
            limited = replace(changed.solver, max_sweeps=min(changed.solver.max_sweeps or 30, 30), time_limit_s=0.5)
            return npl.plan(replace(changed, solver=limited))

        return plan

    table_parts = {"values": table.values, "policy": table.policy, "success": table.success}
    table_parts |= {"stats": table.stats, "scenario": scenario}
    execution = {"policy": policy, "values": values, "greedy": False, "arc_samples": None, "noise": True}
    run = {"runs": 3, "seed": 1, "threads": 1}
    return [
        Door("Lattice", _ppvi.Lattice, LATTICE, RAW),
        Door(
            "Lattice.solve", lattice.solve,
            {"method": "sweep", "partitions": (2, 2), "priority": "H2", "tolerance": 0.1, **LIMITS}, RAW,
        ),
        Door("Lattice.success", lattice.success, {"policy": policy, "threads": 1}, RAW),
        Door("Lattice.expectations", lattice.expectations, {"policy": policy, "threads": 1}, RAW),
        Door("Lattice.rollout", lattice.rollout, {**execution, "starts": starts, "max_steps": 99, **run}, RAW),
        Door(
            "Lattice.path", lattice.path,
            {**execution, "start": [2.0, 12.0, 0.0, 1.0], "seed": 0, "max_steps": 99}, RAW,
        ),
        Door(
            "Lattice.predict", lattice.predict,
            {"policy": policy, "values": values, "success": values, "poses": starts, "threads": 1}, RAW,
        ),
        Door(
            "Lattice.predict of many", lattice.predict,
            {
                "policy": policy, "values": values, "success": values,
                "poses": np.repeat(starts, 500, axis=0), "threads": 1,
            }, RAW,
        ),
        Door("Lattice.outcomes", lambda **_: lattice.outcomes(), {"none": None}, RAW),
        Door("Lattice.tabular", lambda **_: lattice.tabular(), {"none": None}, RAW),
        Door(
            "lookup_many", _ppvi.lookup_many,
            {
                "values": values, "policy": policy, "success": values, "spacing_mm": (2.0, 2.0),
                "size_mm": (30.0, 22.0), "poses": starts, "threads": 1,
            }, RAW,
        ),
        Door(
            "lookup_many of many", _ppvi.lookup_many,
            {
                "values": values, "policy": policy, "success": values, "spacing_mm": (2.0, 2.0),
                "size_mm": (30.0, 22.0), "poses": np.repeat(starts, 500, axis=0), "threads": 1,
            }, RAW,
        ),
        Door("Tabular", _ppvi.Tabular, ROWS, RAW),
        Door(
            "Tabular.solve", rows.solve,
            {"method": "ppvi", "labels": np.array([0, 1, 1], np.uint32), "priority": "H2", "tolerance": 0.1, **LIMITS},
            RAW,
        ),
        Door("Tabular.dependencies", rows.dependencies, {"labels": np.array([0, 1, 1], np.uint32)}, RAW),
        Door("lookup", table.lookup, {"x_mm": 2.0, "y_mm": 12.0, "heading_rad": 0.0, "bevel": 1}, PUBLIC),
        Door("table.lookup_many", table.lookup_many, {"poses": starts}, PUBLIC),
        Door("table.path", table.path, {"start": start, "nearest": False, "noise_seed": 3}, PUBLIC),
        Door(
            "table.rollout",
            lambda runs, **options: table.rollout(runs=runs if too_many(runs) else 3, **options),
            {"start": start, "runs": 5, "seed": 1, "nearest": True}, PUBLIC,
        ),
        Door("best_entry", table.best_entry, {"edge": "left", "x_mm": None, "y_mm": 12.0}, PUBLIC),
        Door("PolicyTable", npl.PolicyTable, table_parts, PUBLIC),
        Door("write", table.write, {"path": "t"}, PUBLIC),
        Door("read", npl.PolicyTable.read, {"path": "nothing.h5"}, PUBLIC),
        Door("plan", npl.plan, {"scenario": scenario, "progress": None}, PUBLIC),
        *(Door(f"plan with {part}", plan_of(part), fields, PUBLIC) for part, fields in plan_parts.items()),
        Door("Pose", npl.Pose, {"x_mm": 1.0, "y_mm": 2.0, "heading_rad": 0.0, "bevel": 1}, PUBLIC),
        Door("Pose.deg", npl.Pose.deg, {"x_mm": 1.0, "y_mm": 2.0, "heading_deg": 90.0, "bevel": 1}, PUBLIC),
        Door("Pose.of", npl.Pose.of, {"pose": [1.0, 2.0, 0.0, 1]}, PUBLIC),
        Door(
            "TabularMdp", npl.mdp.TabularMdp,
            {"transitions": [np.eye(2), np.eye(2)[::-1]], "costs": np.ones((2, 2)), "discount": 0.9}, PUBLIC,
        ),
        Door("from_rows", npl.mdp.TabularMdp.from_rows, ROWS, PUBLIC),
        Door(
            "mdp.solve", npl.mdp.solve,
            {"mdp": mdp, "method": "ppvi", "labels": [0, 1, 1], "priority": "H2", "tolerance": 0.1, **LIMITS}, PUBLIC,
        ),
        Door(
            "mdp.value_iteration", npl.mdp.value_iteration,
            {"mdp": mdp, "tolerance": 0.1, "max_sweeps": 30, "progress": None}, PUBLIC,
        ),
        Door("mdp.dependencies", npl.mdp.dependencies, {"mdp": mdp, "labels": [0, 1, 1]}, PUBLIC),
    ]  # fmt: skip


def too_many(runs: object) -> bool:
    """Whether `runs` is no number of runs, or one beyond the limit; others would only take long."""
    return not isinstance(runs, int | float) or not 0 < runs <= 50_000_000


def hostile_array(array: np.ndarray[Any, Any], rng: random.Random) -> object:
    """Return an array that is wrong in type, shape, order or contents, or only unusual in memory."""

    def with_entry(value: float) -> object:
        changed = array.copy()
        with np.errstate(all="ignore"):
            try:
                changed.flat[rng.randrange(max(changed.size, 1))] = value
            except (OverflowError, ValueError, IndexError):
                return changed.astype(object)
        return changed

    def unaligned() -> object:
        buffer = np.zeros(array.nbytes + 1, np.uint8)
        changed = buffer[1:].view(array.dtype).reshape(array.shape)
        changed[...] = array
        return changed

    def read_only() -> object:
        changed = array.copy()
        changed.flags.writeable = False
        return changed

    kinds = [
        np.float32,
        np.float64,
        np.int8,
        np.int64,
        np.uint8,
        np.uint32,
        np.complex128,
        object,
        "U8",
        ">f8",
        "M8[s]",
    ]
    choices: list[Callable[[], object]] = [
        lambda: array.astype(rng.choice(kinds), copy=False),
        lambda: np.asfortranarray(array), lambda: array[::-1], lambda: array[::2], lambda: array[:0],
        lambda: array[np.newaxis], lambda: array.ravel(), lambda: array.T, lambda: np.concatenate([array, array]),
        lambda: np.broadcast_to(array.flat[0], array.shape), lambda: array.tolist(), unaligned, read_only,
        lambda: np.ma.masked_array(array), lambda: np.full((0, 4), 1.0), lambda: memoryview(array.ravel()),
        lambda: np.broadcast_to(np.zeros(1, array.dtype), (10**6,)),
        *(lambda value=value: with_entry(value) for value in (math.nan, math.inf, -1, 2**31, 2**62, 1e300, 0.5)),
    ]  # fmt: skip
    return rng.choice(choices)()


def hostile(value: Any, rng: random.Random) -> object:
    """Return a replacement for a good argument."""
    if isinstance(value, np.ndarray) and rng.random() < 0.7:
        return hostile_array(value, rng)
    if isinstance(value, tuple | list) and value and rng.random() < 0.5:
        entries = list(value)
        at = rng.randrange(len(entries))
        entries[at] = hostile(entries[at], rng)
        return rng.choice([entries, tuple(entries), entries[:at], entries * 3])
    return rng.choice(SCALARS)


def arguments(door: Door, rng: random.Random) -> dict[str, Any]:
    """Return the good arguments of a call with one to three of them replaced."""
    replaced = rng.sample(list(door.good), k=min(rng.choice([1, 1, 2, 3]), len(door.good)))
    return door.good | {name: hostile(door.good[name], rng) for name in replaced}


def overtime(*_: object) -> None:
    raise Overtime


def main(seed: int, count: int) -> int:
    """Make `count` calls and return the exit code."""
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
    signal.signal(signal.SIGALRM, overtime)
    rng = random.Random(seed)
    answered = refused = interrupted = 0
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        known = doors()
        for number in range(count):
            door = known[number % len(known)]
            given = arguments(door, rng)
            faulthandler.dump_traceback_later(HANGS_S, exit=True)
            try:
                signal.setitimer(signal.ITIMER_REAL, LIMIT_S)
                try:
                    door.call(**given)
                finally:
                    signal.setitimer(signal.ITIMER_REAL, 0)
                answered += 1
            except Overtime:
                interrupted += 1
            except door.documented:
                refused += 1
            except BaseException as error:
                changed = {key: value for key, value in given.items() if value is not door.good[key]}
                print(f"call {number}, {door.name}: {type(error).__name__}: {error}\n{changed}", file=sys.stderr)
                return 1
            faulthandler.cancel_dump_traceback_later()
    print(f"{answered} answered, {refused} refused, {interrupted} interrupted")
    return 0


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1]), int(sys.argv[2])))
