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
from needleplan.config import Integer
from needleplan.errors import InputError, Mistake
from needleplan.page._answers import InsertingPage, Unknown
from needleplan.page._files import LANGUAGES
from needleplan.page._requests import Request, pack, page_html, value_of
from needleplan.page._space_maps import SpaceCode, SpaceMaps, surface
from needleplan.planning import SpacePose, SpaceTable, Uncertainty, entries_vtp, markups_text, success_bytes

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray

    from needleplan.anatomy import Anatomy
    from needleplan.page._recorded_space import SpaceRun

__all__ = ["SpacePage"]

# Number of executions that are drawn.
_DRAWN = 40
# Steps of success in the field, which is drawn with 256 colours.
_FIELD_STEPS = 255
# Steps of clearance in a mm; with the largest clearance, 30 mm, they fit into a byte.
_CLEARANCE_STEPS = 8


class SpacePage(InsertingPage):
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
        self._uncertainty = Uncertainty()
        several = anatomy is not None and table is None and bool(anatomy.file.anatomy.targets)
        self.title: str = anatomy.file.title if anatomy is not None and several else scenario.title
        self._code = SpaceCode(
            run.source if run else source, is_table=table is not None, several=several, recording=source if run else ""
        )
        self._pool = ThreadPoolExecutor(1, "space")
        self._entries: Future[SpaceMaps] = self._pool.submit(lambda: SpaceMaps(scenario, anatomy, table))

    def promise_under(self, uncertainty: Uncertainty) -> None:
        """Show the success of entries under errors, too, from now on."""
        self._uncertainty = uncertainty

    def start(self) -> dict[str, Any]:
        """Return the values that the page shows first: `source`, `title`, and whether it shows a recording."""
        return {"source": self._source, "title": self.title, "is_recording": self._run is not None}

    def works(self) -> dict[str, Callable[[Request], bytes]]:
        """Return the functions that answer requests, by path."""
        return {
            "/api/volume": self.volume,
            "/api/entry": self.entry,
            "/api/estimate": self.estimate,
            "/api/slicer": lambda request: markups_text(self._maps.of(request), self._maps.listed).encode(),
            "/api/vtp": lambda request: entries_vtp(self._maps.of(request), self._maps.listed),
            "/api/nifti": lambda request: success_bytes(self._maps.of(request)),
            "/api/recording": self.recording,
            "/api/table": self.table,
            "/api/insert": self.insert,
            "/api/inserted": self.inserted,
            "/api/code": self.code,
            "/api/page": self.page,
        }

    def close(self) -> None:
        """Stop an insertion that is running, and end the thread, once a solve that has begun is done."""
        self._stop_twin()
        self._pool.shutdown(wait=True, cancel_futures=True)

    def volume(self, request: Request) -> bytes:
        """Return the message on the anatomy: codes, labels, success field, surfaces, entry points and ranked list.

        Of several targets, the fields, the points and the numbers are those of the target of the request. Waits for the
        solve, and for the executions that compare the entries of the list.
        """
        maps = self._maps
        entries = maps.of(request)
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
            "targets": maps.targets,
            "target": request.get("target") or next(iter(maps.targets), ""),
            "ranked": [self._record(number, request) for number in maps.listed],
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
        for name, kind, body in self._bodies(header["target"], labels, names):
            if body.any():
                number = len(header["bodies"])
                header["bodies"].append({"name": name, "kind": kind})
                arrays[f"vertices{number}"], arrays[f"triangles{number}"] = surface(body, grid.frame.spacing_mm)
        return pack(header, arrays)

    def entry(self, request: Request) -> bytes:
        """Return the message on one entry: its numbers, the path without noise, and executions with noise.

        Its success is by executions if they are known, else by the table, which is at once; `estimate` makes them.
        """
        return self._entry(request, promised=False)

    def _entry(self, request: Request, *, promised: bool) -> bytes:
        entries, number = self._maps.of(request), self._number(request)
        found = entries.table.executions(entries.poses[number], _DRAWN)
        points = [found.points(run) for run in range(_DRAWN)]
        arrays: dict[str, NDArray[Any]] = {
            "path_mm": entries.paths.points(number).astype(np.float32),
            "runs_mm": np.concatenate(points).astype(np.float32),
            "ends": np.cumsum([len(point) for point in points], dtype=np.uint32),
            "reached": found.reached.astype(np.uint8),
        }
        header = self._record(number, request) | {"risk": self._maps.risk(number, request)}
        header |= self._promise(number, request) if promised else {}
        return pack(header, arrays)

    def estimate(self, request: Request) -> bytes:
        """Return the packed record of the requested entry, with its success by simulated executions (about 1 s)."""
        number = self._number(request)
        estimated = self._maps.entry(number, request).record()
        told = {"number": number, **estimated, **self._maps.of_targets(number), **self._promise(number, request)}
        return pack(told, {})

    def _promise(self, number: int, request: Request) -> dict[str, Any]:
        """Return the record of the success of an entry under errors; an empty one if everything is known exactly."""
        if self._uncertainty.is_exact:
            return {}
        entries = self._maps.of(request)
        return {"promise": entries.table.success_under(self._uncertainty, entries.poses[number]).record()}

    def insert(self, request: Request) -> bytes:
        """Begin an insertion in the lab twin from the entry of a request, and return the first message on it."""
        entries = self._maps.of(request)
        start = SpacePose(*entries.poses[self._number(request)].tolist())
        self._twin.begin(entries.table, start, request)
        return self.inserted({})

    def table(self, request: Request) -> bytes:
        """Return the policy table as a file."""
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "table.h5"
            self._maps.of(request).table.write(file)
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
        """Return the number of the entry in a request; the default is the best entry. Raises InputError."""
        entries = self._maps.of(request)
        return int(value_of(request, "number", Integer(0, len(entries.success) - 1), entries.first()))

    def recording(self, _: Request) -> bytes:
        """Return the message on the recorded insertion. Raises Unknown if none was opened."""
        if self._run is None:
            raise Unknown
        return self._run.message(self._maps.of({}).table)

    def page(self, request: Request) -> bytes:
        """Return the page of the plan as one HTML file, with the ranked entries or the recording."""
        code = {"command": self._code.command(), "python": self._code.python(self._number({}))}
        targets = [{"target": name} for name in self._maps.targets] or [{}]
        messages = {_path("/api/volume", target): self.volume(target) for target in targets}
        if self._run is None:
            listed = self._maps.listed
            messages |= {
                _path(f"/api/entry {number}", target): self._entry({"number": number, **target}, promised=True)
                for target in targets for number in listed
            }  # fmt: skip
            code |= {f"python {number}": self._code.python(number) for number in listed}
        else:
            messages["/api/recording"] = self.recording(request)
        return page_html(
            {
                "start": {**self.start(), "offline": True, "targets": self._maps.targets},
                "messages": {path: base64.b64encode(each).decode() for path, each in messages.items()},
                "code": code,
            },
            self.document,
            "space.js",
        )

    def _record(self, number: int, request: Request) -> dict[str, Any]:
        """Return the numbers of an entry, with its success as far as it is known."""
        maps = self._maps
        return {"number": number, **maps.entry(number, request, runs=0).record(), **maps.of_targets(number)}

    @property
    def _maps(self) -> SpaceMaps:
        """The ranked entries, once they are there. Raises the error of the solve."""
        return self._entries.result()

    @cached_property
    def _labels(self) -> tuple[NDArray[np.uint8], list[str]]:
        """Rank of the label at each grid point, 255 outside the volume, and the names of the labels by rank.

        A table holds no labels, and volumes with more than 255 labels are shown without them: then no rank is known.
        """
        grid = self._maps.of({}).grid
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
        self, target: str, labels: NDArray[np.uint8], names: list[str]
    ) -> Iterator[tuple[str, str, NDArray[np.bool_]]]:
        """Yield name, kind and grid points of what the 3D view shows, and the targets of other paths."""
        maps = self._maps
        grid = maps.of({"target": target}).grid
        yield target or "target", "target", grid.codes == TARGET
        for other in maps.targets:
            if other != target:
                yield other, "other target", maps.of({"target": other}).grid.codes == TARGET
        if self._anatomy is None or not names:
            yield "obstacles with margin", "obstacle", grid.codes == OBSTACLE
            return
        present = np.unique(self._anatomy.volume.labels)
        for number in self._anatomy.numbers(self._anatomy.file.anatomy.obstacles):
            rank = int(np.searchsorted(present, number))
            if rank < len(present) and present[rank] == number:
                yield names[rank], "obstacle", (labels == rank) & (grid.codes != OUTSIDE)


def _path(path: str, target: Request) -> str:
    """Return the path of a message of the exported page, with the name of the target where there are several."""
    return " ".join([path, *target.values()])
