"""Plan, execute and diagnose the steering of flexible bevel-tip needles.

::

    import needleplan as npl

    table = npl.plan("four_obstacles")
    entry = table.best_entry()
    print(table.rollout(entry).success)

Units everywhere: mm, N, s, rad. Plane: x along the insertion, y lateral; the heading is the tip tangent from +x,
counter-clockwise positive; the bevel is -1 or +1, the sign of the arc's curvature.
"""

TYPE_CHECKING = False  # instead of an import of `typing`, which takes 10 ms and which `needleplan stop` cannot spare

if TYPE_CHECKING:
    from needleplan import mdp, models, recording
    from needleplan.diagnosis import diagnose
    from needleplan.errors import InputError, NeedleplanError
    from needleplan.extras.installed import show_versions
    from needleplan.opening import open
    from needleplan.page import view
    from needleplan.planning import Action, Edge, Outcome, PolicyTable, Pose, Status, Success, Table, plan
    from needleplan.scenario import Obstacle, Scenario
    from needleplan.sweep import TableSet

    __version__: str

__all__ = [
    "Action",
    "Edge",
    "InputError",
    "NeedleplanError",
    "Obstacle",
    "Outcome",
    "PolicyTable",
    "Pose",
    "Scenario",
    "Status",
    "Success",
    "Table",
    "TableSet",
    "__version__",
    "diagnose",
    "mdp",
    "models",
    "open",
    "plan",
    "recording",
    "show_versions",
    "view",
]

# Module that defines a public name; names that are missing here are modules themselves.
_HOMES = {
    "Action": "planning",
    "Edge": "planning",
    "InputError": "errors",
    "NeedleplanError": "errors",
    "Obstacle": "scenario",
    "Outcome": "planning",
    "PolicyTable": "planning",
    "Pose": "planning",
    "Scenario": "scenario",
    "Status": "planning",
    "Success": "planning",
    "Table": "planning",
    "TableSet": "sweep",
    "diagnose": "diagnosis",
    "open": "opening",
    "plan": "planning",
    "show_versions": "extras.installed",
    "view": "page",
}
# Former names with the present ones, for the message.
_RENAMED = {"Atlas": "TableSet"}


def __getattr__(name: str) -> object:
    """Import a public name when it is first used, so that small commands start fast."""
    from importlib import import_module

    if name not in __all__:
        hint = f"; it is now {_RENAMED[name]}" if name in _RENAMED else ""
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}{hint}")
    if name == "__version__":
        value: object = import_module(f"{__name__}.artifacts").version()
    elif name in _HOMES:
        value = getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
    else:
        return import_module(f"{__name__}.{name}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return __all__
