"""Plan, execute and diagnose the steering of flexible bevel-tip needles.

::

    import needleplan as npl

    scenario = npl.Scenario.read("four_obstacles")
    table = npl.plan(scenario)
    entry = table.best_entry()
    print(table.rollout(entry.pose).success)

Units everywhere: mm, N, s, rad. Plane: x along the insertion, y lateral; the heading is the tip tangent from +x,
counter-clockwise positive; the bevel is -1 or +1, the sign of the arc's curvature.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from needleplan import mdp, models
    from needleplan.diagnosis import diagnose
    from needleplan.errors import InputError, NeedleplanError
    from needleplan.planning import PolicyTable, plan
    from needleplan.scenario import Scenario

__all__ = ["InputError", "NeedleplanError", "PolicyTable", "Scenario", "diagnose", "mdp", "models", "plan"]

_HOMES = {
    "InputError": "errors",
    "NeedleplanError": "errors",
    "PolicyTable": "planning",
    "Scenario": "scenario",
    "diagnose": "diagnosis",
    "plan": "planning",
}


def __getattr__(name: str) -> object:
    """Import a public name when it is first used, so that small commands start fast."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    if name not in _HOMES:
        return import_module(f"{__name__}.{name}")
    value = getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return __all__
