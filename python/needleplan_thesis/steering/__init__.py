"""Many insertions in the lab twin: steered by the loop, without feedback, not steered; what comes of them."""

from needleplan_thesis.steering.course import Course, Guidance, Task
from needleplan_thesis.steering.series import run_all
from needleplan_thesis.steering.summary import Summary, gap_closed, summarized
from needleplan_thesis.steering.trial import Trial, run_trial

__all__ = ["Course", "Guidance", "Summary", "Task", "Trial", "gap_closed", "run_all", "run_trial", "summarized"]
