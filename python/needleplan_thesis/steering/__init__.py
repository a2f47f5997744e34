"""Insertions in the lab twin, with and without feedback, and their statistics."""

from needleplan_thesis.steering._case import Guidance, SteeringCase, SteeringTask, steering_simulation
from needleplan_thesis.steering._trial import SteeringSummary, SteeringTrial, gap_closed, run_all, run_trial, summarized
from needleplan_thesis.steering._unguided import Moves, PathEnd, aimed_at_target, execute_moves, path_end, planned_moves

__all__ = [
    "Guidance",
    "Moves",
    "PathEnd",
    "SteeringCase",
    "SteeringSummary",
    "SteeringTask",
    "SteeringTrial",
    "aimed_at_target",
    "execute_moves",
    "gap_closed",
    "path_end",
    "planned_moves",
    "run_all",
    "run_trial",
    "steering_simulation",
    "summarized",
]
