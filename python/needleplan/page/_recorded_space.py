"""A recorded insertion in space for the page, and the plan that it followed."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from needleplan.anatomy import Anatomy, AnatomyFile, SpaceScenario
from needleplan.errors import DataError, Mistake
from needleplan.page._packing import pack
from needleplan.page._recorded import force_along, messages_of, thinned
from needleplan.planning import Action, SpacePose, SpaceTable

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from needleplan.recording import Recording

__all__ = ["SpaceRun", "is_space_run"]


def is_space_run(recording: Recording) -> bool:
    """Return whether a recording is one of an insertion in space."""
    return "anatomy.toml" in recording.session.texts and "/tip" in recording.counts


class SpaceRun:
    """A recorded insertion in space.

    Parameters
    ----------
    recording : Recording
        The recording.
    plan : SpaceTable, Anatomy or None
        What the insertion followed; None takes the anatomy whose volume stands beside the recording.
    source : str, optional
        Name of the file of the plan. Default: no name.

    Raises
    ------
    DataError
        If the plan is another one than that of the insertion, or if there is no plan and no volume beside the
        recording.
    """

    def __init__(self, recording: Recording, plan: SpaceTable | Anatomy | None, source: str = "") -> None:
        self._recording, self.source = recording, source
        self.is_table = isinstance(plan, SpaceTable)
        self.anatomy: Anatomy | None = None
        digests = recording.session.digests
        if isinstance(plan, SpaceTable):
            self.plan: SpaceTable | SpaceScenario = plan
            name, found = "table", plan.digest
        else:
            self.anatomy = plan or _anatomy_beside(recording)
            self.plan = SpaceScenario.of(self.anatomy)
            name, found = "scenario", self.plan.digest
        if digests.get(name) != found:
            rule = "is not the plan of this insertion: give its table (.h5) or its anatomy (.toml) with --table"
            raise DataError(Mistake("--table", found[:19], rule), str(recording.path))

    def message(self, table: SpaceTable) -> bytes:
        """Return the message on the insertion. Times are in s from the first message, positions in the lattice's frame.

        `table` is the table of the plan.
        """
        from needleplan.control import path_distances_mm  # needs the extra `lab`, as recordings do

        recording = self._recording
        columns = recording.columns("/tip")
        tip = np.stack([columns["time_s"] - recording.start_ns * 1e-9, *(columns[f"{each}_mm"] for each in "xyz")], 1)
        decisions, events = messages_of(recording, _decision)
        planned = _planned(recording, table)
        radius_mm = table.scenario.target_radius_mm
        away = None
        if len(planned) > 1:
            away = path_distances_mm(_prolonged(planned, 2 * radius_mm), tip[:, 1:])
            away[columns["depth_mm"] < 0] = 0.0  # before the entry
        kept = thinned(np.column_stack([tip, *([] if away is None else [away])])).astype(np.float32)
        force = thinned(force_along(recording)).astype(np.float32)
        arrays: dict[str, NDArray[Any]] = {
            "tip_time_s": kept[:, 0], "tip": kept[:, 1:4], "planned_mm": planned.astype(np.float32),
        }  # fmt: skip
        if away is not None:
            arrays["deviation_mm"] = kept[:, 4]
        if len(force):
            arrays |= {"force_time_s": force[:, 0], "force_n": force[:, 1]}
        end = next((each for each in reversed(events) if each["name"] == "end"), None)
        header = {
            "duration_s": recording.duration_s, "decisions": decisions, "events": events,
            "target_radius_mm": radius_mm,
            "ended": end["cause"] if end else None,
            "error_mm": float(np.linalg.norm(tip[-1, 1:] - table.scenario.target_mm)) if len(tip) else None,
            "turns": sum(each["action"] == Action.ROTATE.name.lower() for each in decisions),
            "replans": sum(each["name"] == "table_swapped" for each in events),
        }  # fmt: skip
        return pack(header, arrays)


def _anatomy_beside(recording: Recording) -> Anatomy:
    """Return the anatomy of the insertion, whose volume and colour table stand in the folder of the recording."""
    file = AnatomyFile.from_toml(recording.session.texts["anatomy.toml"], str(recording.path))
    volume = Path(recording.path).parent / file.anatomy.file
    if not volume.exists():
        rule = (
            f"is an insertion in space, and {volume.name} is not beside it: give the table or the anatomy with --table"
        )
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
    return table.path(table.clamped(SpacePose(*first.values["pose"]))).points(0)


def _prolonged(line: NDArray[np.float64], length_mm: float) -> NDArray[np.float64]:
    """Return a line with a straight end, which leads into the target, as in the report of an insertion."""
    ahead = line[-1] - line[-2]
    return np.vstack([line, line[-1] + length_mm * ahead / max(float(np.linalg.norm(ahead)), 1e-12)])
