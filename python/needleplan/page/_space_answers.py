"""What the server answers on a 3D plan: the anatomy on the lattice, its entries ranked, and one entry."""

from __future__ import annotations

import base64
import tempfile
from concurrent.futures import Future, ThreadPoolExecutor
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from needleplan.anatomy import OBSTACLE, OUTSIDE, TARGET, SpaceScenario, nearest_labels
from needleplan.errors import InputError, Mistake
from needleplan.page._answers import Unknown
from needleplan.page._export import page_html
from needleplan.page._files import LANGUAGES
from needleplan.page._packing import pack
from needleplan.page._requests import Request
from needleplan.page._space_code import SpaceCode
from needleplan.page._surface import surface
from needleplan.planning import (
    EntryMap,
    SpacePose,
    SpaceTable,
    entries_vtp,
    entry_map,
    markups_text,
    plan_space,
    success_bytes,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray

    from needleplan.anatomy import Anatomy, AnatomyGrid
    from needleplan.page._inserted import LabTwin
    from needleplan.page._recorded_space import SpaceRun

__all__ = ["SpacePage"]

# Number of ranked entries, as `needleplan entry` lists them, and of executions that are drawn.
_TOP, _DRAWN = 5, 40
# Steps of success in the field, which is drawn with 256 colours.
_FIELD_STEPS = 255
# Steps of clearance in a mm; with the largest clearance, 30 mm, they fit into a byte.
_CLEARANCE_STEPS = 8


class SpacePage:
    """Answers the requests of the 3D page. The lattice is solved in a thread that begins at once.

    Parameters
    ----------
    scenario : SpaceScenario
        What `needleplan view` has opened.
    source : str
        Name of its file.
    anatomy : Anatomy, optional
        The anatomy of the scenario, whose labels the page shows. Default: none, as for a table.
    run : SpaceRun, optional
        A recorded insertion by this plan, which the page replays. Default: none.
    table : SpaceTable, optional
        The table of the scenario. Default: it is planned.
    """

    document = "space.html"

    def __init__(
        self,
        scenario: SpaceScenario,
        source: str,
        anatomy: Anatomy | None = None,
        run: SpaceRun | None = None,
        *,
        table: SpaceTable | None = None,
    ) -> None:
        self._source, self._anatomy, self._run = source, anatomy, run
        self._code = SpaceCode(run.source if run else source, table is not None, source if run else "")
        self.title: str = scenario.title
        self._pool = ThreadPoolExecutor(1, "space")
        self._entries: Future[EntryMap] = self._pool.submit(lambda: entry_map(table or plan_space(scenario)))

    def start(self) -> dict[str, Any]:
        """Return the values that the page shows first: `source`, `title`, and whether it shows a recording."""
        return {"source": self._source, "title": self.title, "is_recording": self._run is not None}

    def works(self) -> dict[str, Callable[[Request], bytes]]:
        """Return the functions that answer requests, by path."""
        return {
            "/api/volume": self.volume,
            "/api/entry": self.entry,
            "/api/estimate": self.estimate,
            "/api/slicer": lambda _: markups_text(self._ready, self._listed).encode(),
            "/api/vtp": lambda _: entries_vtp(self._ready, self._listed),
            "/api/nifti": lambda _: success_bytes(self._ready),
            "/api/recording": self.recording,
            "/api/table": self.table,
            "/api/insert": self.insert,
            "/api/inserted": self.inserted,
            "/api/code": self.code,
            "/api/page": self.page,
        }

    def close(self) -> None:
        """Stop an insertion that is running, and end the thread, once a solve that has begun is done."""
        if "_twin" in vars(self):  # somebody has inserted
            self._twin.stop()
        self._pool.shutdown(wait=True, cancel_futures=True)

    def volume(self, _: Request) -> bytes:
        """Return the message on the anatomy: codes, labels, success field, surfaces, entry points and ranked list.

        Waits for the solve, and for the executions that compare the entries of the list.
        """
        entries = self._ready
        grid, table = entries.grid, entries.table
        labels, names = self._labels
        header: dict[str, Any] = {
            "title": self.title,
            "plan": table.digest,
            "shape": grid.frame.shape,
            "spacing_mm": grid.frame.spacing_mm,
            "origin_mm": grid.frame.origin_mm.tolist(),
            "axes": grid.frame.axes.tolist(),
            "letters": [grid.frame.letters(axis) for axis in range(3)],
            "radii_mm": [float(each) for each in grid.radii_mm],
            "labels": names,
            "states": table.stats.states,
            "seconds": table.stats.seconds,
            "status": str(table.stats.status),
            "impossible": entries.impossible,
            "reachable": entries.reachable,
            "ranked": [self._record(number) for number in self._listed],
        }
        arrays: dict[str, NDArray[Any]] = {
            "codes": grid.codes,
            "tissues": grid.tissues,
            "clearance": np.clip(np.rint(grid.clearance_mm * _CLEARANCE_STEPS), 0, 255).astype(np.uint8),
            "label_numbers": labels,
            "field": np.rint(entries.success_field() * _FIELD_STEPS).astype(np.uint8),
            "points_mm": entries.poses[:, :3].astype(np.float32),
            "success": entries.success.astype(np.float32),
        }
        header["bodies"] = []
        for name, kind, body in self._bodies(grid, labels, names):
            if body.any():
                number = len(header["bodies"])
                header["bodies"].append({"name": name, "kind": kind})
                arrays[f"vertices{number}"], arrays[f"triangles{number}"] = surface(body, grid.frame.spacing_mm)
        return pack(header, arrays)

    def entry(self, request: Request) -> bytes:
        """Return the message on one entry: its numbers, the path without noise, and executions with noise.

        Its success is by executions if they are known, else by the table, which is at once; `estimate` makes them.
        """
        entries, number = self._ready, self._number(request)
        found = entries.table.executions(entries.poses[number], _DRAWN)
        points = [found.points(run) for run in range(_DRAWN)]
        arrays: dict[str, NDArray[Any]] = {
            "path_mm": entries.paths.points(number).astype(np.float32),
            "runs_mm": np.concatenate(points).astype(np.float32),
            "ends": np.cumsum([len(point) for point in points], dtype=np.uint32),
            "reached": found.reached.astype(np.uint8),
        }
        return pack(self._record(number), arrays)

    def estimate(self, request: Request) -> bytes:
        """Return the packed record of the requested entry, with its success by simulated executions (about 1 s)."""
        number = self._number(request)
        return pack({"number": number, **self._ready.entry(number).record()}, {})

    @cached_property
    def _twin(self) -> LabTwin:
        """The lab twin. It needs the extra `lab`, which a page without an insertion does not."""
        from needleplan.page._inserted import LabTwin

        return LabTwin()

    def insert(self, request: Request) -> bytes:
        """Begin an insertion in the lab twin from the entry of a request, and return the first message on it."""
        start = SpacePose(*self._ready.poses[self._number(request)].tolist())
        self._twin.begin(self._ready.table, start, request)
        return self.inserted({})

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

    def table(self, _: Request) -> bytes:
        """Return the policy table as a file."""
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "table.h5"
            self._ready.table.write(file)
            return file.read_bytes()

    def code(self, request: Request) -> bytes:
        """Return Python or commands that compute what the page shows."""
        language = request.get("language")
        if language not in LANGUAGES:
            raise InputError(Mistake("language", f"{language}", "must be python or command"))
        text = self._code.command() if language == "command" else self._code.python(self._number(request))
        if not text:
            raise InputError(Mistake("code", "", "is not known: this plan is from no file"))
        return text.encode()

    def _number(self, request: Request) -> int:
        """Return the number of the entry of a request, by default that of the best. Raises InputError."""
        entries = self._ready
        number = request.get("number", entries.first())
        if not isinstance(number, int) or isinstance(number, bool) or not 0 <= number < len(entries.success):
            rule = f"must be a whole number from 0 to {len(entries.success) - 1}"
            raise InputError(Mistake("number", f"{number}", rule))
        return number

    def recording(self, _: Request) -> bytes:
        """Return the message on the recorded insertion. Raises Unknown if none was opened."""
        if self._run is None:
            raise Unknown
        return self._run.message(self._ready.table)

    def page(self, request: Request) -> bytes:
        """Return the page of the plan as one HTML file, with the ranked entries or the recording."""
        code = {"command": self._code.command(), "python": self._code.python(self._number({}))}
        messages = {"/api/volume": self.volume(request)}
        if self._run is None:
            messages |= {f"/api/entry {number}": self.entry({"number": number}) for number in self._listed}
            code |= {f"python {number}": self._code.python(number) for number in self._listed}
        else:
            messages["/api/recording"] = self.recording(request)
        return page_html(
            {
                "start": {**self.start(), "offline": True},
                "messages": {path: base64.b64encode(each).decode() for path, each in messages.items()},
                "code": code,
            },
            self.document,
            "space.js",
        )

    def _record(self, number: int) -> dict[str, Any]:
        """Return the numbers of an entry, with its success as far as it is known."""
        return {"number": number, **self._ready.entry(number, runs=0).record()}

    @property
    def _listed(self) -> list[int]:
        """The ranked entries, as `needleplan entry` lists them."""
        return self._ready.best(_TOP)

    @property
    def _ready(self) -> EntryMap:
        """The ranked entries, once they are there. Raises the error of the solve."""
        return self._entries.result()

    @cached_property
    def _labels(self) -> tuple[NDArray[np.uint8], list[str]]:
        """Rank of the label at each grid point, 255 outside the volume, and the names of the labels by rank.

        A table holds no labels, and volumes with more than 255 labels are shown without them: then no rank is known.
        """
        grid = self._ready.grid
        if self._anatomy is None:
            return np.full(grid.codes.shape, 255, np.uint8), []
        volume = self._anatomy.volume
        present = np.unique(volume.labels)
        if len(present) > 255:
            return np.full(grid.codes.shape, 255, np.uint8), []
        names = {number: name for name, number in self._anatomy.names.items()}
        ranks = np.searchsorted(present, volume.labels).astype(np.uint8)
        return nearest_labels(volume, ranks, grid.frame, 255), [
            names.get(int(each), f"label {each}" if each else "background") for each in present
        ]

    def _bodies(
        self, grid: AnatomyGrid, labels: NDArray[np.uint8], names: list[str]
    ) -> Iterator[tuple[str, str, NDArray[np.bool_]]]:
        """Yield name, kind and grid points of what the 3D view shows."""
        yield "target", "target", grid.codes == TARGET
        if self._anatomy is None or not names:
            yield "obstacles with margin", "obstacle", grid.codes == OBSTACLE
            return
        present = np.unique(self._anatomy.volume.labels)
        for number in self._anatomy.numbers(self._anatomy.file.anatomy.obstacles):
            rank = int(np.searchsorted(present, number))
            if rank < len(present) and present[rank] == number:
                yield names[rank], "obstacle", (labels == rank) & (grid.codes != OUTSIDE)
