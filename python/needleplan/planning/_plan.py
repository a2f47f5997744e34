"""`plan`: solves a scenario in the plane or an anatomy in 3D, given as an object, a file or a shipped name."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any, overload

from needleplan.anatomy import Anatomy, AnatomyFile, SpaceScenario
from needleplan.artifacts import FileKind, file_format
from needleplan.errors import InputError, Mistake, ScenarioError
from needleplan.extras.progress_bar import progress_bar, solve_text
from needleplan.planning._lattice import Progress, require_callable
from needleplan.planning._planner import plan_plane
from needleplan.planning._space_plan import plan_space
from needleplan.planning._space_table import SpaceTable
from needleplan.planning._table import PolicyTable
from needleplan.scenario import Scenario, ShippedScenario, shipped

__all__ = ["plan", "read_problem"]


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
    source = os.fspath(path)
    if source in shipped() and not Path(path).is_file():
        return Scenario.read(path)
    kind = file_format(path).kind
    if kind is FileKind.ANATOMY:
        return Anatomy.read(path)
    if kind in (None, FileKind.SCENARIO):
        return Scenario.read(path)
    rule = f"cannot be planned: its kind is {kind}; scenarios and anatomies can. `npl.open` opens it"
    raise ScenarioError(rule, source)


def _brief(value: object) -> str:
    """Return the repr of a value, shortened to its type if it is long."""
    text = repr(value)
    return text if len(text) <= 80 else f"<{type(value).__name__}>"
