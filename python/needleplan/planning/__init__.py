"""Planning: computing a policy table from a scenario, and looking up and executing its policy."""

from needleplan.planning._best_plane import AnatomyPlane, best_plane
from needleplan.planning._coded import Action, Outcome
from needleplan.planning._contract import Table
from needleplan.planning._edge import EdgeProfile, edge_profile
from needleplan.planning._execution import MOST_STEPS, Path, Rollouts, wilson
from needleplan.planning._guide import guide_pose
from needleplan.planning._lattice import Progress, Stats, Status, heading_refinement, lattice_of
from needleplan.planning._lookup import Decision, Decisions, Expectations
from needleplan.planning._mat_file import write_mat
from needleplan.planning._plan_figure import draw_plan
from needleplan.planning._planner import plan, read_problem
from needleplan.planning._poses import Edge, Entry, Pose
from needleplan.planning._promise import Promise, PromisingTable
from needleplan.planning._resolution import Resolution, disagrees, resolution, resolution_of, what_helps
from needleplan.planning._seal import FORMAT as TABLE_FORMAT
from needleplan.planning._seal import is_signed
from needleplan.planning._space import EntryMap, SpaceEntry, entry_map, rank_entries
from needleplan.planning._space_breathing import ResidualSuccess, success_in_breath
from needleplan.planning._space_drawing import draw_entries
from needleplan.planning._space_export import entries_vtp, markups_text, success_bytes, targets_markups_text
from needleplan.planning._space_limits import KeptEntries, LimitCount
from needleplan.planning._space_path import SpacePath, SpacePaths, bend_direction, codes_along, step_points
from needleplan.planning._space_plan import SpaceTask, plan_ahead, plan_space
from needleplan.planning._space_pose import SpacePose
from needleplan.planning._space_problem import space_of
from needleplan.planning._space_table import SpaceDecision, SpaceStats, SpaceTable
from needleplan.planning._success import Success, SuccessSource
from needleplan.planning._table import PolicyTable
from needleplan.planning._targets import TargetEntry, TargetMap, rank_for_targets
from needleplan.planning._tip_noise import PlannedNoise, planned_noise
from needleplan.planning._uncertainty import Uncertainty
from needleplan.planning._unreached import Unreached, impossible_message, unreached
from needleplan.planning._vtp import vtp_bytes

__all__ = [
    "MOST_STEPS",
    "TABLE_FORMAT",
    "Action",
    "AnatomyPlane",
    "Decision",
    "Decisions",
    "Edge",
    "EdgeProfile",
    "Entry",
    "EntryMap",
    "Expectations",
    "KeptEntries",
    "LimitCount",
    "Outcome",
    "Path",
    "PlannedNoise",
    "PolicyTable",
    "Pose",
    "Progress",
    "Promise",
    "PromisingTable",
    "ResidualSuccess",
    "Resolution",
    "Rollouts",
    "SpaceDecision",
    "SpaceEntry",
    "SpacePath",
    "SpacePaths",
    "SpacePose",
    "SpaceStats",
    "SpaceTable",
    "SpaceTask",
    "Stats",
    "Status",
    "Success",
    "SuccessSource",
    "Table",
    "TargetEntry",
    "TargetMap",
    "Uncertainty",
    "Unreached",
    "bend_direction",
    "best_plane",
    "codes_along",
    "disagrees",
    "draw_entries",
    "draw_plan",
    "edge_profile",
    "entries_vtp",
    "entry_map",
    "guide_pose",
    "heading_refinement",
    "impossible_message",
    "is_signed",
    "lattice_of",
    "markups_text",
    "plan",
    "plan_ahead",
    "plan_space",
    "planned_noise",
    "rank_entries",
    "rank_for_targets",
    "read_problem",
    "resolution",
    "resolution_of",
    "space_of",
    "step_points",
    "success_bytes",
    "success_in_breath",
    "targets_markups_text",
    "unreached",
    "vtp_bytes",
    "what_helps",
    "wilson",
    "write_mat",
]
