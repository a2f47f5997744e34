"""Files of the page: scenarios that it opens and saves, downloads, and code that reproduces a plan."""

from __future__ import annotations

import re
import shlex
import tempfile
import threading
from pathlib import Path
from typing import TYPE_CHECKING

from needleplan.config import raw_of
from needleplan.errors import InputError, Mistake, ScenarioError
from needleplan.page._requests import Request, pack, plain, scenario_of, start_of
from needleplan.planning import draw_plan
from needleplan.scenario import Scenario, shipped

if TYPE_CHECKING:
    from needleplan.page._queue import PlanQueue
    from needleplan.planning import PolicyTable

__all__ = ["LANGUAGES", "PageFiles"]

_FORMATS = ("svg", "png")

LANGUAGES = ("python", "command")
"""Languages in which the page hands out code."""

# Setting the style of matplotlib is not safe in several threads.
_drawing = threading.Lock()


class PageFiles:
    """Makes the files of the page.

    `opened` is the scenario that was opened, and `source` the name of its file or of a shipped one. Without a name,
    code holds the text of the scenario.
    """

    def __init__(self, queue: PlanQueue, opened: Scenario, source: str, *, is_table: bool) -> None:
        self._queue = queue
        self._opened = opened if source else None
        self._source = source
        self._is_table = is_table

    def open(self, request: Request) -> bytes:
        """Return the message with the scenario in a text, or with a shipped one. Raises ScenarioError."""
        name = request.get("shipped")
        if name is not None:
            if name not in shipped():
                raise ScenarioError(Mistake("shipped", f"{name}", "must be the name of a shipped scenario"))
            scenario = Scenario.read(name)
        else:
            scenario = Scenario.from_toml(str(request.get("text", "")), str(request.get("name", "")))
        return pack({"scenario": plain(raw_of(scenario))}, {})

    def toml(self, request: Request) -> bytes:
        """Return the scenario of a request as a commented file."""
        return scenario_of(request).to_toml(commented=True).encode()

    def table(self, request: Request) -> bytes:
        """Return the policy table of a request as a file."""
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "table.h5"
            self._solved(request).write(file)
            return file.read_bytes()

    def figure(self, request: Request) -> bytes:
        """Return the figure of the plan of a request, as `needleplan plan --figure` draws it."""
        kind = request.get("format")
        if kind not in _FORMATS:
            raise InputError(Mistake("format", f"{kind}", f"must be one of {', '.join(_FORMATS)}"))
        table = self._solved(request)
        start, _ = start_of(request, table)
        with _drawing, tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / f"plan.{kind}"
            draw_plan(table, start, file)
            return file.read_bytes()

    def code(self, request: Request) -> bytes:
        """Return Python or commands that compute what the page shows for a request."""
        scenario = scenario_of(request)
        language = request.get("language")
        if language == "python":
            return self._python(scenario, request).encode()
        if language == "command":
            return self._commands(scenario, request).encode()
        raise InputError(Mistake("language", f"{language}", "must be python or command"))

    def _solved(self, request: Request) -> PolicyTable:
        return self._queue.submit("download", scenario_of(request)).result()

    def _python(self, scenario: Scenario, request: Request) -> str:
        start, runs = request.get("start"), int(request.get("runs", 2000))
        lines = ["import needleplan as npl", ""]
        if scenario == self._opened and self._is_table:
            lines.append(f"table = npl.PolicyTable.read({self._source!r})")
        else:
            text = scenario.to_toml()
            quoted = f"r'''{text}'''" if "'''" not in text else repr(text)
            read = (
                f"npl.Scenario.read({self._source!r})"
                if scenario == self._opened
                else f"npl.Scenario.from_toml({quoted})"
            )
            lines += [f"scenario = {read}", "table = npl.plan(scenario)"]
        if start is None:
            lines.append(f"start = table.best_entry({str(request.get('edge', 'left'))!r})")
        else:
            lines.append(f"start = table.start(npl.Pose.deg({', '.join(map(repr, _numbers(start)))}))")
        lines += [
            "path = table.path(start)",
            f"rollouts = table.rollout(start, runs={runs})",
            "print(path)",
            "print(rollouts)",
        ]
        return "\n".join([*lines, ""])

    def _commands(self, scenario: Scenario, request: Request) -> str:
        start, runs = request.get("start"), int(request.get("runs", 2000))
        name = "_".join(re.findall(r"[a-z0-9]+", str(request.get("name", "")).lower())) or "scenario"
        table, lines = f"{name}.h5", []
        if scenario == self._opened:
            file = shlex.quote(self._source)
        else:
            file = f"{name}.toml"
            lines.append(f"cat > {file} <<'END OF SCENARIO'\n{scenario.to_toml()}END OF SCENARIO")
        if scenario == self._opened and self._is_table:
            table = file
        else:
            lines.append(f"needleplan plan {file} -o {table}")
        option = ""
        if start is not None:
            option = f" --start={','.join(map(repr, _numbers(start)))}"
        elif request.get("edge", "left") != "left":
            raise InputError(Mistake("edge", str(request["edge"]), "must be left for commands; choose a start"))
        lines += [f"needleplan path {table}{option}", f"needleplan evaluate {table}{option} --runs {runs}"]
        return "\n".join([*lines, ""])


def _numbers(start: dict[str, float]) -> list[float]:
    """Return x_mm, y_mm, heading_deg and, if known, bevel. Raises InputError."""
    try:
        found = [float(start[key]) for key in ("x_mm", "y_mm", "heading_deg")]
        return [*found, int(start["bevel"])] if start.get("bevel") is not None else found
    except (TypeError, KeyError, ValueError, AttributeError):
        raise InputError(Mistake("start", "", "must have x_mm, y_mm and heading_deg, and may have a bevel")) from None
