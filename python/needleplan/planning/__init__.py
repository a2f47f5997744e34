"""Planning: from a scenario to a policy table, and what a table answers."""

from needleplan.planning.entry import Edge, Entry
from needleplan.planning.execution import Path, Rollouts
from needleplan.planning.planner import plan
from needleplan.planning.pose import Action, Outcome, Pose
from needleplan.planning.stats import Progress, Stats, Status
from needleplan.planning.table import Decision, Decisions, Expectations, PolicyTable

__all__ = [
    "Action",
    "Decision",
    "Decisions",
    "Edge",
    "Entry",
    "Expectations",
    "Outcome",
    "Path",
    "PolicyTable",
    "Pose",
    "Progress",
    "Rollouts",
    "Stats",
    "Status",
    "plan",
]
