"""What the server answers: plans, paths, executions and fields of policy tables, as messages for the page."""

from __future__ import annotations

import base64
import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from needleplan.config import Integer, raw_of
from needleplan.errors import Mistake, PoseError
from needleplan.page._files import LANGUAGES, PageFiles
from needleplan.page._queue import PlanQueue
from needleplan.page._recorded import nearest_risk, recorded_plan, track_message
from needleplan.page._requests import (
    Request,
    best_success,
    draft_of,
    pack,
    page_html,
    plain,
    scenario_of,
    shares,
    start_of,
    value_of,
)
from needleplan.planning import Outcome, Pose, resolution_of
from needleplan.scenario import Scenario, shipped

if TYPE_CHECKING:
    from collections.abc import Callable
    from concurrent.futures import Future

    from numpy.typing import NDArray

    from needleplan.page._inserted import LabTwin
    from needleplan.planning import Path, PolicyTable
    from needleplan.recording import Recording

__all__ = ["InsertingPage", "Opened", "Page", "Unknown"]

# Largest number of executions of one request.
_MOST_RUNS = 100_000


class Unknown(Exception):
    """The server has no table of the plan that a request names, for example because it was restarted."""


class InsertingPage:
    """Base of the pages of a plan, which show insertions of the lab twin."""

    @cached_property
    def _twin(self) -> LabTwin:
        """The lab twin. It needs the extra `lab`, which a page without an insertion does not."""
        from needleplan.page._inserted import LabTwin

        return LabTwin()

    def inserted(self, request: Request) -> bytes:
        """Return the message on the insertion up to now, as for a recording; stop it first if `stop` is true.

        Raises Unknown if there was none.
        """
        if request.get("stop"):
            self._twin.stop()
        found = self._twin.state()
        if found is None:
            raise Unknown
        return found

    def _stop_twin(self) -> None:
        """Stop an insertion that is running."""
        if "_twin" in vars(self):  # somebody has inserted
            self._twin.stop()


@dataclass(frozen=True)
class Opened:
    """What `needleplan view` has opened.

    Attributes
    ----------
    scenario : Scenario
        The scenario, or that of the table.
    source : str
        Name of the file or of the shipped scenario.
    table : PolicyTable or None
        The table, if one was opened.
    start : Pose or None
        Where the needle begins; None is the best entry on the left edge.
    recording : Recording or None
        A recorded insertion, which the page replays.
    """

    scenario: Scenario
    source: str
    table: PolicyTable | None = None
    start: Pose | None = None
    recording: Recording | None = None

    @classmethod
    def of_recording(cls, recording: Recording) -> Opened:
        """Return a recorded insertion with its scenario. Raises DataError if the recording is another one."""
        scenario, start = recorded_plan(recording)
        return cls(scenario, str(recording.path), start=start, recording=recording)


class Page(InsertingPage):
    """Answers the requests of the page; it has no state but the tables of its queue."""

    document = "index.html"

    def __init__(self, opened: Opened) -> None:
        self.queue: PlanQueue = PlanQueue()
        # A recording holds its scenario as a text: code cannot read it as a scenario file.
        source = opened.source if opened.recording is None else ""
        self.files: PageFiles = PageFiles(self.queue, opened.scenario, source, is_table=opened.table is not None)
        self._opened = opened
        if opened.table is not None:
            self.queue.keep(opened.table)
        else:
            self.queue.submit("", draft_of(opened.scenario))  # solved while the browser starts

    @property
    def title(self) -> str:
        """Title of the scenario."""
        return self._opened.scenario.title

    def start(self) -> dict[str, Any]:
        """Return the values that the page shows first: the opened scenario, and the names of the shipped scenarios."""
        scenario = self._opened.scenario
        return {
            "source": self._opened.source,
            "digest": scenario.digest,
            "scenario": plain(raw_of(scenario)),
            "start": None if self._opened.start is None else _pose_of(self._opened.start),
            "shipped": shipped(),
            "is_recording": self._opened.recording is not None,
        }

    def works(self) -> dict[str, Callable[[Request], bytes]]:
        """Return the functions that answer requests, by path; plans are answered by `submit` and `planned`."""
        of_files = (self.files.open, self.files.toml, self.files.table, self.files.figure, self.files.code)
        of_plans = (self.path, self.field, self.executions, self.recording, self.insert, self.inserted, self.page)
        return {f"/api/{work.__name__}": work for work in (*of_plans, *of_files)}

    def close(self) -> None:
        """End the threads of the queue, and stop an insertion that is running."""
        self._stop_twin()
        self.queue.close()

    def submit(self, request: Request) -> Future[PolicyTable]:
        """Begin the plan of the scenario of a request. Raises InputError if the scenario is wrong."""
        scenario = scenario_of(request)
        if request.get("draft") and self.queue.find(scenario.digest) is None:
            scenario = draft_of(scenario)
        return self.queue.submit(str(request.get("tab", ""))[:64], scenario)

    def planned(self, request: Request, table: PolicyTable) -> bytes:
        """Return the message on a finished plan: certificates, success field, path from the start.

        Parameters
        ----------
        request : dict
            Request of the page.
        table : PolicyTable
            Table of the plan. If it is not of the requested scenario, the message calls it a draft.

        Returns
        -------
        bytes

        Raises
        ------
        InputError
            The scenario or the start of the request is invalid.
        """
        wanted = scenario_of(request)
        stats = table.stats
        header: dict[str, Any] = {
            "plan": table.scenario.digest,
            "draft": table.scenario.digest != wanted.digest,
            "states": table.scenario.states,
            "shape": table.scenario.shape,
            "spacing_mm": table.scenario.grid.spacing_mm,
            "status": stats.status,
            "seconds": stats.seconds,
            "error_bound": stats.error_bound,
        }
        start, automatic = start_of(request, table, is_draft=header["draft"])
        described, arrays = _path_answer(table, table.path(start))
        if not header["draft"]:
            header["best_success"] = best_success(request, table)
        return pack(
            {**header, "automatic": automatic, **described}, {**arrays, **_field_of(table, request.get("heading_deg"))}
        )

    def path(self, request: Request) -> bytes:
        """Return the message on the path from the start of a request."""
        table = self.table_of(request)
        start, automatic = start_of(request, table)
        described, arrays = _path_answer(table, table.path(start))
        return pack({"plan": table.scenario.digest, "automatic": automatic, **described}, arrays)

    def field(self, request: Request) -> bytes:
        """Return the message with the success field for a heading, or for the best heading at each position."""
        table = self.table_of(request)
        return pack({"plan": table.scenario.digest}, _field_of(table, request.get("heading_deg")))

    def executions(self, request: Request) -> bytes:
        """Return the message on executions with tip noise: predicted and realised success, and some executions."""
        table = self.table_of(request)
        start, _ = start_of(request, table)
        runs = value_of(request, "runs", Integer(1, _MOST_RUNS), 2000)
        found = table.rollout(start, runs)
        header = {
            "plan": table.scenario.digest,
            "start": _pose_of(found.start),
            "runs": runs,
            "success": found.success,
            "interval": found.interval,
            "predicted_success": found.predicted_success,
            "outcomes": {str(outcome): count for outcome, count in found.outcomes.items()},
            "mean_turns": found.mean_turns,
            "mean_length_mm": found.mean_length_mm,
            "mean_cost": found.mean_cost,
            "predicted_cost": found.predicted_value,
            "warnings": resolution_of(table, found).warnings,
        }
        points = [path.poses[:, :2].astype(np.float32) for path in found.samples]
        arrays: dict[str, NDArray[Any]] = {
            "points": np.concatenate(points),
            "ends": np.cumsum([len(point) for point in points], dtype=np.uint32),
            "outcomes": np.array([path.outcome.code for path in found.samples], dtype=np.uint8),
        }
        return pack(header, arrays)

    def recording(self, _: Request) -> bytes:
        """Return the message on the recorded insertion. Raises Unknown if none was opened."""
        if self._opened.recording is None:
            raise Unknown
        return track_message(self._opened.recording)

    def insert(self, request: Request) -> bytes:
        """Begin an insertion in the lab twin by the plan of a request, and return the first message on it."""
        table = self.table_of(request)
        start, _ = start_of(request, table)
        self._twin.begin(table, table.path(start).start, request)  # `path` checks the start
        return self.inserted(request)

    def page(self, request: Request) -> bytes:
        """Return the page of the plan of a request as one HTML file that needs no server."""
        scenario = scenario_of(request)
        table = self.queue.submit("download", scenario).result()
        messages = {
            "/api/plan": self.planned(request, table),
            "/api/executions": self.executions({**request, "plan": scenario.digest}),
        }
        if self._opened.recording is not None:
            messages["/api/recording"] = self.recording(request)
        start = {**self.start(), "scenario": plain(raw_of(scenario)), "start": request.get("start"), "offline": True}
        return page_html(
            {
                "start": start,
                "messages": {path: base64.b64encode(each).decode() for path, each in messages.items()},
                "toml": self.files.toml(request).decode(),
                "code": {each: self.files.code({**request, "language": each}).decode() for each in LANGUAGES},
            }
        )

    def table_of(self, request: Request) -> PolicyTable:
        """Return the table of the plan that a request names. Raises Unknown."""
        table = self.queue.find(str(request.get("plan")))
        if table is None:
            raise Unknown
        return table


def _pose_of(pose: Pose) -> dict[str, Any]:
    """Return a pose as the page holds it, with the heading in degrees."""
    x, y, heading, bevel = pose
    return {"x_mm": x, "y_mm": y, "heading_deg": math.degrees(heading), "bevel": bevel}


def _path_answer(table: PolicyTable, path: Path) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Return what the page shows of a path: header and arrays of a message."""
    decision = table.lookup(path.start)
    header = {
        "start": _pose_of(path.start),
        "outcome": str(path.outcome),
        "reached": path.outcome is Outcome.TARGET,
        "length_mm": path.length_mm,
        "turns": len(path.turns),
        "cost": path.cost,
        "predicted_success": decision.success,
        "predicted_cost": decision.value,
        "risk": nearest_risk(table.scenario, path.points_mm),
    }
    return header, {"poses": path.poses.astype(np.float32), "actions": path.actions}


def _field_of(table: PolicyTable, heading_deg: Any) -> dict[str, NDArray[Any]]:
    """Return arrays [nx, ny]: success, cost, and number of the heading and bevel that they are for.

    The number is 2 * heading + (0 for bevel -1, 1 for bevel +1). Without a heading, the best one at each position is
    taken; the bevel is always the better one.
    """
    nx, ny, headings, _ = table.success.shape
    if heading_deg is None:
        flat = table.success.reshape(nx * ny, -1)
        first = 0
    else:
        try:
            first = round(float(heading_deg) / 360 * headings) % headings
        except (TypeError, ValueError, OverflowError):
            raise PoseError(Mistake("heading_deg", str(heading_deg), "must be a number of degrees")) from None
        flat = table.success[:, :, first].reshape(nx * ny, 2)
    best = flat.argmax(axis=1)
    rows = np.arange(nx * ny)
    state = best + 2 * first
    value = table.values.reshape(nx * ny, -1)[rows, state]
    return {
        "success": shares(flat[rows, best]).reshape(nx, ny),
        "costs": value.reshape(nx, ny),
        "state": state.astype(np.uint32).reshape(nx, ny),
    }
