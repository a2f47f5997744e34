"""Whether a grid fits into memory."""

from __future__ import annotations

from pathlib import Path

from needleplan.errors import Mistake, ScenarioError
from needleplan.scenario import Method, Scenario

__all__ = ["BYTES_PER_STATE", "available_bytes", "require_memory"]

BYTES_PER_STATE = {Method.SWEEP: 36, Method.PPVI: 180, Method.VALUE_ITERATION: 180}
"""Peak of planning, measured: the table (9), the solver's copies, what the arcs lead to; the sweeps work in single
precision on the lattice, the other methods in double precision on any Markov decision process."""

BYTES_PER_FINER_STATE = 24
"""Peak of an evaluation on a finer grid, measured: 17 to 21."""

_MOST_STATES = 2**31 - 1


def require_memory(scenario: Scenario) -> None:
    """Raise ScenarioError where planning would need more memory than there is."""
    states, times = scenario.states, scenario.grid.success_refinement
    finer = states * times**2 if times > 1 else 0
    needed = states * BYTES_PER_STATE[scenario.solver.method] + finer * BYTES_PER_FINER_STATE
    available = available_bytes()
    if max(states, finer) <= _MOST_STATES and (available is None or needed <= available):
        return
    reason = (
        f"the grid has {states:,} states"
        + (f", {finer:,} with success_refinement = {times}," if finer else "")
        + f" and needs about {_readable(needed)} of memory"
        + (f"; {_readable(available)} are available" if available is not None else "")
        + (f"; at most {_MOST_STATES:,} states can be numbered" if max(states, finer) > _MOST_STATES else "")
        + "; take a coarser spacing, fewer headings or a smaller workspace"
        + ("" if scenario.solver.method is Method.SWEEP else ', or solver.method = "sweep"')
    )
    raise ScenarioError(Mistake("grid.spacing_mm", str(list(scenario.grid.spacing_mm)), reason))


def available_bytes() -> int | None:
    """Return the memory that can be used without swapping, or None where the system does not say."""
    limits = [limit for limit in (_of_machine(), _of_control_group()) if limit is not None]
    return min(limits, default=None)


def _of_machine() -> int | None:
    try:
        lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
    except OSError:
        return None
    return next((int(line.split()[1]) * 1024 for line in lines if line.startswith("MemAvailable:")), None)


def _of_control_group() -> int | None:
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
