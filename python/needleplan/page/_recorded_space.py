"""A recorded 3D insertion for the page, and the plan that it followed."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from needleplan.anatomy import Anatomy, AnatomyFile, SpaceScenario
from needleplan.errors import DataError, Mistake
from needleplan.page._recorded import force_along, messages_of, thinned
from needleplan.page._requests import pack
from needleplan.page._sensed import Sensed
from needleplan.planning import Action, SpacePose, SpaceTable

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from needleplan.recording import Recording

__all__ = ["SpaceRun", "is_space_run", "packed_space_track"]


def is_space_run(recording: Recording) -> bool:
    """Return whether a recording is one of a 3D insertion."""
    return "anatomy.toml" in recording.session.texts and bool(recording.counts.get("/tip"))


class SpaceRun:
    """A recorded 3D insertion.

    Parameters
    ----------
    recording : Recording
        The recording.
    anatomy : Anatomy, optional
        What the insertion followed, if its table is not given. Default: the anatomy whose volume stands beside the
        recording.
    source : str, optional
        Name of the file of the plan. Default: no name.
    table : SpaceTable, optional
        The table that the insertion followed. Default: it is planned again.

    Raises
    ------
    DataError
        If the plan is another one than that of the insertion, or if there is no plan and no volume beside the
        recording.
    """

    source: str
    table: SpaceTable | None
    scenario: SpaceScenario

    def __init__(
        self,
        recording: Recording,
        anatomy: Anatomy | None = None,
        source: str = "",
        *,
        table: SpaceTable | None = None,
    ) -> None:
        self._recording, self.source, self.table = recording, source, table
        self.anatomy: Anatomy | None = anatomy
        if table is None:
            self.anatomy = anatomy or _anatomy_beside(recording)
            self.scenario = SpaceScenario.of(self.anatomy)
            name, found = "scenario", self.scenario.digest
        else:
            self.scenario = table.scenario
            name, found = "table", table.digest
        if recording.session.digests.get(name) != found:
            rule = "is not the plan of this insertion: give its table (.h5) or its anatomy (.toml) with --table"
            raise DataError(Mistake("--table", found[:19], rule), str(recording.path))

    def message(self, table: SpaceTable) -> bytes:
        """Return the message on the insertion. Times are in s from the first message, positions in the lattice's frame.

        `table` is the table of the plan.
        """
        recording = self._recording
        columns = recording.columns("/tip")
        time_s = columns["time_s"] - recording.start_ns * 1e-9
        tip = np.stack([time_s, *(columns[f"{each}_mm"] for each in ("x", "y", "z", "depth"))], 1)
        decisions, events = messages_of(recording, _decision)
        header = {"duration_s": recording.duration_s, "decisions": decisions, "events": events}
        sensed = Sensed.of(recording)
        return packed_space_track(header, table, _planned(recording, table), tip, force_along(recording), sensed)


def packed_space_track(
    header: Mapping[str, Any],
    table: SpaceTable,
    planned: NDArray[np.float64],
    tip: NDArray[np.float64],
    force: NDArray[np.float64],
    sensed: Sensed | None = None,
) -> bytes:
    """Return the message on a 3D insertion.

    Parameters
    ----------
    header : dict
        `duration_s`, `decisions` and `events`, with times in s, and what else the message holds.
    table : SpaceTable
        The plan.
    planned : numpy.ndarray
        Points of the planned path (mm), shape (n, 3).
    tip : numpy.ndarray
        Time (s), x, y and z of the tip (mm) and depth, or length of the path (mm), shape (m, 5).
    force : numpy.ndarray
        Time (s) and axial force (N), shape (k, 2).
    sensed : Sensed, optional
        Samples of curvature sensors and images.

    Returns
    -------
    bytes
    """
    from needleplan.control import path_distances_mm  # needs the extra `lab`, as recordings do

    scenario = table.scenario
    kept, force = thinned(tip), thinned(force).astype(np.float32)
    arrays: dict[str, NDArray[Any]] = {
        "tip_time_s": kept[:, 0].astype(np.float32), "tip": kept[:, 1:4].astype(np.float32),
        "planned_mm": planned.astype(np.float32),
    }  # fmt: skip
    arrays["risk_mm"] = scenario.grid.clearance_at(kept[:, 1:4]).astype(np.float32)
    if len(planned) > 1:
        away = path_distances_mm(_prolonged(planned, 2 * scenario.target_reach_mm), kept[:, 1:4])
        away[kept[:, 4] < 0] = 0.0  # before the entry
        arrays["deviation_mm"] = away.astype(np.float32)
    if len(force):
        arrays |= {"force_time_s": force[:, 0], "force_n": force[:, 1]}
    events = header["events"]
    end = next((event for event in reversed(events) if event["name"] == "end"), None)
    more = {
        "target_radius_mm": scenario.target_radius_mm,
        "ended": end["cause"] if end else None,
        "error_mm": float(np.linalg.norm(tip[-1, 1:4] - scenario.target_mm)) if len(tip) else None,
        "turns": sum(each["action"] == Action.ROTATE.name.lower() for each in header["decisions"]),
        "replans": sum(event["name"] == "table_swapped" for event in events),
    }
    told, measured = sensed.packed(in_space=True) if sensed else ({}, {})
    return pack({**header, **more, **told}, {**arrays, **measured})


def _anatomy_beside(recording: Recording) -> Anatomy:
    """Return the anatomy of the insertion, whose volume and colour table stand in the folder of the recording."""
    file = AnatomyFile.from_toml(recording.session.texts["anatomy.toml"], str(recording.path))
    volume = Path(recording.path).parent / file.anatomy.file
    if not volume.exists():
        rule = f"is a 3D insertion, and {volume.name} is not beside it: give the table or the anatomy with --table"
        raise DataError(rule, str(recording.path))
    return Anatomy.of(file, Path(recording.path).parent)


def _decision(values: Any) -> dict[str, Any]:
    x, y, z = values["pose"][:3]
    return {"x_mm": x, "y_mm": y, "z_mm": z, "action": values.get("action"), "success": values.get("success")}


def _planned(recording: Recording, table: SpaceTable) -> NDArray[np.float64]:
    """Return the path that the table plans from the first decision, shape (n, 3); n is 0 without a decision."""
    first = next(iter(recording.messages(["/decision"])), None) if "/decision" in recording.counts else None
    if first is None:
        return np.empty((0, 3))
    return table.path(table.clamped(SpacePose(*first.values["pose"]))).points_mm


def _prolonged(line: NDArray[np.float64], length_mm: float) -> NDArray[np.float64]:
    """Return a line with a straight end, which leads into the target, as in the report of an insertion."""
    ahead = line[-1] - line[-2]
    return np.vstack([line, line[-1] + length_mm * ahead / max(float(np.linalg.norm(ahead)), 1e-12)])
