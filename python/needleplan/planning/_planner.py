"""`plan`: solves a scenario in the plane or an anatomy in 3D, given as an object, a file or a shipped name.

In the plane, it first checks sizes and memory.
"""

from __future__ import annotations

import os
from pathlib import Path
from time import perf_counter
from typing import Any, overload

from needleplan.anatomy import Anatomy, AnatomyFile, SpaceScenario
from needleplan.artifacts import FileKind, file_format
from needleplan.errors import InputError, Mistake, ScenarioError
from needleplan.extras.progress_bar import progress_bar, solve_text
from needleplan.planning._lattice import (
    Progress,
    compiled_call,
    every,
    finer,
    heading_refinement,
    lattice_of,
    require_callable,
    stats_of,
    success_of,
    success_refinement,
    with_headings,
)
from needleplan.planning._space_plan import plan_space
from needleplan.planning._space_table import SpaceTable
from needleplan.planning._table import PolicyTable
from needleplan.scenario import Method, Scenario, ShippedScenario

__all__ = [
    "BYTES_PER_FINER_STATE",
    "BYTES_PER_STATE",
    "available_bytes",
    "plan",
    "plan_plane",
    "questionable_sizes",
    "read_problem",
    "require_memory",
]

# Peak memory of planning, in bytes per state: the table (9), outcomes of the arcs, copies of the solver. Measured:
# 17 to 18 (sweep), 35 to 40 (ppvi), 23 (vi). The other methods compute in double precision.
BYTES_PER_STATE = {Method.SWEEP: 20, Method.PPVI: 45, Method.VALUE_ITERATION: 26}

# What straight steps add, in bytes per state: their outcomes, in the layout of the lattice and in that of the sweeps.
BYTES_PER_STRAIGHT_STEP = 2

# Peak memory of the evaluation on a finer grid, in bytes per state of that grid.
BYTES_PER_FINER_STATE = 22

# Radius, as a part of the longer side of the workspace, below which it is probably in metres: the needle would turn in
# circles next to where it enters.
_LEAST_RADIUS = 0.02

# Target radius (mm) below which it is probably in metres.
_LEAST_TARGET_MM = 0.02

# Ratio of the step to the spacing above which the spacing is probably in metres, and below which the needle takes so
# many steps to leave a cell that the solve hardly ends.
_LARGEST_STEP_CELLS, _LEAST_STEP_CELLS = 500, 0.02

# Largest number of states; the solver numbers states in 31 bits.
_MOST_STATES = 2**31 - 1


@overload
def plan(scenario: Scenario, progress: Progress | bool | None = None, *, accept_units: bool = False) -> PolicyTable: ...
@overload
def plan(
    scenario: Anatomy | AnatomyFile | SpaceScenario,
    progress: Progress | bool | None = None,
    *,
    accept_units: bool = False,
    target_name: str | None = None,
) -> SpaceTable: ...
@overload
def plan(
    scenario: ShippedScenario | str | os.PathLike[str],
    progress: Progress | bool | None = None,
    *,
    accept_units: bool = False,
    target_name: str | None = None,
) -> PolicyTable | Any: ...


def plan(
    scenario: Scenario | Anatomy | AnatomyFile | SpaceScenario | str | os.PathLike[str],
    progress: Progress | bool | None = None,
    *,
    accept_units: bool = False,
    target_name: str | None = None,
) -> PolicyTable | SpaceTable:
    """Solve a scenario, or an anatomy, into a policy table.

    Parameters
    ----------
    scenario : Scenario, Anatomy, AnatomyFile, SpaceScenario, str or path
        A scenario, planned in the plane; an anatomy, planned in 3D; the path of a file with one of them; or the name of
        a shipped scenario. The volume of an `AnatomyFile` is looked for in the working directory.
    progress : callable or bool, optional
        True: show a bar on the terminal or in the notebook. A function is called in this thread during the solve, at
        most every 0.05 s, and at the end, with three numbers. In the plane: the number of sweeps so far, the residual,
        and the residual at which the solve ends. In 3D, the first number is the finished fraction of the solve. An
        exception that it raises abandons the solve and leaves this function, as Ctrl-C does; but StopIteration ends the
        solve with the values so far and the status "interrupted".
    accept_units : bool, default False
        Plan even if a size is so unlikely that its unit is probably wrong, such as a radius in metres. Without effect
        in 3D, where the volume has the units.
    target_name : str, optional
        Name of one of several targets of an anatomy. Default: the only target.

    Returns
    -------
    PolicyTable or SpaceTable
        Values, policy and success probability of every state, in the plane or in 3D. A solve that reaches a limit
        before it converges returns its table too; `table.stats.status` shows this.

    Raises
    ------
    ScenarioError
        If scenario or anatomy cannot be read, the grid is too large for the memory, or a size is questionable.
    InputError
        If `progress` cannot be called.

    Examples
    --------
    >>> import needleplan as npl
    >>> npl.plan("four_obstacles")
    <PolicyTable "Four obstacles": 121 x 81 x 60 x 2 = 1,176,120 states, converged>
    """
    problem = read_problem(scenario) if isinstance(scenario, str | os.PathLike) else scenario
    if isinstance(progress, bool):
        with progress_bar(progress) as show:
            if isinstance(problem, Scenario):
                return plan(problem, lambda *state: show(solve_text(*state)), accept_units=accept_units)
            return plan(problem, lambda done, *_: show("solving", done), target_name=target_name)
    require_callable(progress, InputError)
    if target_name is not None and not isinstance(problem, Anatomy | AnatomyFile):
        raise ScenarioError(Mistake("target_name", str(target_name), "is for an anatomy with several targets"))
    if isinstance(problem, Scenario):
        return plan_plane(problem, progress, accept_units=accept_units)
    if isinstance(problem, AnatomyFile):
        problem = Anatomy.of(problem)
    if isinstance(problem, Anatomy):
        problem = SpaceScenario.of(problem, target_name)
    if not isinstance(problem, SpaceScenario):
        rule = "must be a scenario, an anatomy, the path of a file with one of them, or the name of a shipped scenario"
        raise ScenarioError(Mistake("scenario", _brief(problem), rule))
    return plan_space(problem, progress=progress)


def read_problem(path: str | os.PathLike[str]) -> Scenario | Anatomy:
    """Return the scenario or the anatomy in a file, or a shipped scenario. Raises ScenarioError for other files."""
    kind = file_format(path).kind
    if kind is FileKind.ANATOMY:
        return Anatomy.read(path)
    if kind in (None, FileKind.SCENARIO):
        return Scenario.read(path)
    rule = f"cannot be planned: its kind is {kind}; scenarios and anatomies can. `npl.open` opens it"
    raise ScenarioError(rule, os.fspath(path))


def _brief(value: object) -> str:
    """Return the repr of a value, shortened to its type if it is long."""
    text = repr(value)
    return text if len(text) <= 80 else f"<{type(value).__name__}>"


def plan_plane(scenario: Scenario, progress: Progress | None = None, *, accept_units: bool = False) -> PolicyTable:
    """Solve a scenario of the plane into a policy table; arguments and errors as `plan`."""
    require_callable(progress, InputError)
    require_memory(scenario)
    if not accept_units and (mistakes := questionable_sizes(scenario)):
        raise ScenarioError(mistakes)
    began = perf_counter()
    scenario = with_headings(scenario)
    solver, times = scenario.solver, scenario.grid.refinement or 1
    fine = scenario if times == 1 else finer(scenario, times)
    lattice = lattice_of(fine)
    solved = compiled_call(
        ScenarioError,
        lattice.solve,
        method=solver.method.value,
        partitions=scenario.partitions,
        priority=solver.priority.value,
        tolerance=solver.tolerance,
        max_sweeps=solver.max_sweeps,
        time_limit_s=solver.time_limit_s,
        threads=solver.threads,
        progress=progress,
    )
    values, policy = solved["values"], solved["policy"]
    shape = scenario.shape
    values, policy = every(times, values, shape), every(times, policy, shape)
    success, success_error_bound = success_of(scenario, lattice, solved, values)
    stats = stats_of(solved, fine.states, perf_counter() - began, success_error_bound)
    table = PolicyTable(values, policy, success, stats, scenario)
    if times == 1:
        vars(table)["lattice"] = lattice
    return table


def questionable_sizes(scenario: Scenario) -> list[Mistake]:
    """Return a mistake for every size that is so unlikely that its unit is probably wrong."""
    longer = max(scenario.workspace.width_mm, scenario.workspace.height_mm)
    radii = {"needle.curvature_radius_mm": scenario.needle.curvature_radius_mm}
    for number, layer in enumerate(scenario.needle.layers, start=1):
        radii[f"needle.layer {number}.curvature_radius_mm"] = layer.curvature_radius_mm
    for number, tissue in enumerate(scenario.tissues, start=1):
        radii[f"tissue {number}.curvature_radius_mm"] = tissue.curvature_radius_mm
    small = f"is questionably small beside the workspace of {longer:g} mm, in metres?"
    unlikely = [(key, radius, small) for key, radius in radii.items() if radius < _LEAST_RADIUS * longer]
    if scenario.target.radius_mm < _LEAST_TARGET_MM:
        unlikely.append(("target.radius_mm", scenario.target.radius_mm, "is questionably small, in metres?"))
    cells = [scenario.step_mm / spacing for spacing in scenario.grid.spacing_mm]
    step = f"a step of {scenario.step_mm:.3g} mm"
    if max(cells) > _LARGEST_STEP_CELLS:
        rule = f"is questionably small beside {step}, in metres?"
        unlikely.append(("grid.spacing_mm", min(scenario.grid.spacing_mm), rule))
    elif min(cells) < _LEAST_STEP_CELLS and not unlikely:
        rule = f"is questionably large beside {step}; are there too many headings?"
        unlikely.append(("grid.spacing_mm", max(scenario.grid.spacing_mm), rule))
    return [
        Mistake(
            key,
            f"{size:g} mm",
            f"{rule} Convert it, or accept the units as they are (--accept-units, accept_units=True)",
        )
        for key, size, rule in unlikely
    ]


def require_memory(scenario: Scenario) -> None:
    """Raise ScenarioError if planning needs more memory than is available."""
    grid = scenario.grid
    table_states, times = scenario.states * heading_refinement(scenario), success_refinement(scenario)
    states = table_states * (grid.refinement or 1) ** 2
    finer = table_states * times**2 if times > 1 else 0
    straight = 0 if scenario.motion.straight_curvature_share is None else BYTES_PER_STRAIGHT_STEP
    needed = states * (BYTES_PER_STATE[scenario.solver.method] + straight) + finer * (BYTES_PER_FINER_STATE + straight)
    available = available_bytes()
    if max(states, finer) <= _MOST_STATES and (available is None or needed <= available):
        return
    reason = (
        f"the grid has {states:,} states"
        + (f" with refinement = {grid.refinement or 1}" if states > scenario.states else "")
        + (f", at most {finer:,} with success_refinement = {times}," if finer else "")
        + f" and needs about {_readable(needed)} of memory"
        + (f"; {_readable(available)} are available" if available is not None else "")
        + (f"; at most {_MOST_STATES:,} states can be numbered" if max(states, finer) > _MOST_STATES else "")
        + "; choose a coarser spacing, fewer headings or a smaller workspace"
        + ("" if scenario.solver.method is Method.SWEEP else ', or solver.method = "sweep"')
    )
    raise ScenarioError(Mistake("grid.spacing_mm", str(list(scenario.grid.spacing_mm)), reason))


def available_bytes() -> int | None:
    """Return the memory in bytes that can be used without swapping, or None if the system does not report it."""
    limits = [limit for limit in (_machine_bytes(), _control_group_bytes()) if limit is not None]
    return min(limits, default=None)


def _machine_bytes() -> int | None:
    try:
        lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
    except OSError:
        return None
    return next((int(line.split()[1]) * 1024 for line in lines if line.startswith("MemAvailable:")), None)


def _control_group_bytes() -> int | None:
    group = Path("/sys/fs/cgroup")
    try:
        limit, used = ((group / name).read_text(encoding="ascii") for name in ("memory.max", "memory.current"))
    except OSError:
        return None
    return int(limit) - int(used) if limit.strip().isdecimal() else None


def _readable(size: float) -> str:
    for unit in ("bytes", "kB", "MB", "GB"):
        if size < 1000:
            return f"{size:.3g} {unit}"
        size /= 1000
    return f"{size:.3g} TB" if size < 1000 else f"{size:,.0f} TB"
