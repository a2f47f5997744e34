"""Planning: computing a policy table from a scenario, and looking up and executing its policy."""

from needleplan.planning._execution import MOST_STEPS, Path, Rollouts, wilson
from needleplan.planning._guide import guide_pose, success_over_entries
from needleplan.planning._lattice import Progress, Stats, Status, lattice_of
from needleplan.planning._lookup import Decision, Decisions, Expectations
from needleplan.planning._planner import plan
from needleplan.planning._poses import Action, Edge, Entry, Outcome, Pose
from needleplan.planning._seal import FORMAT as TABLE_FORMAT
from needleplan.planning._seal import is_signed
from needleplan.planning._space import EntryMap, SpaceEntry, rank_entries
from needleplan.planning._space_drawing import draw_entries
from needleplan.planning._space_export import markups_text, success_bytes
from needleplan.planning._table import PolicyTable

__all__ = [
    "MOST_STEPS",
    "TABLE_FORMAT",
    "Action",
    "Decision",
    "Decisions",
    "Edge",
    "Entry",
    "EntryMap",
    "Expectations",
    "Outcome",
    "Path",
    "PolicyTable",
    "Pose",
    "Progress",
    "Rollouts",
    "SpaceEntry",
    "Stats",
    "Status",
    "draw_entries",
    "guide_pose",
    "is_signed",
    "lattice_of",
    "markups_text",
    "plan",
    "rank_entries",
    "success_bytes",
    "success_over_entries",
    "wilson",
]
