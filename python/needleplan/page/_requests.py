"""What a request of the page asks for: its scenario, the draft of the scenario, and the start of the needle.

Binary answers of the page: a JSON header, followed by arrays of numbers.

The page of one plan in one file: styles, modules, data, and a policy that lets it load nothing else.
"""

from __future__ import annotations

import base64
import hashlib
import json
import math
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any
from weakref import WeakKeyDictionary

import numpy as np

from needleplan.config import Rule, Violation, toml_text, under
from needleplan.errors import InputError, Mistake, PoseError
from needleplan.planning import Pose
from needleplan.scenario import Scenario

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from needleplan.planning import Entry, PolicyTable

__all__ = [
    "STATIC",
    "Request",
    "best_success",
    "draft_of",
    "pack",
    "page_html",
    "plain",
    "scenario_of",
    "shares",
    "start_of",
    "value_of",
]


# Arrays begin at multiples of this number of bytes, as typed arrays of JavaScript require.
_ALIGNMENT = 8


def value_of(request: Request, key: str, rule: Rule, default: object) -> Any:
    """Return a value of a request, or `default` without it. Raises InputError if it does not obey the rule."""
    try:
        return rule.read(request.get(key, default))
    except Violation as broken:
        raise InputError(list(under(key, broken.mistakes))) from None


def pack(header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> bytes:
    """Return one message: length of the JSON text (uint32, little-endian), JSON text, arrays.

    The JSON object has the keys of `header` and the key `arrays`: for each name the dtype, the shape, and the offset in
    bytes from the end of the padded JSON text. All numbers are little-endian.
    """
    places: dict[str, Any] = {}
    parts: list[bytes] = []
    offset = 0
    for name, array in arrays.items():
        data = np.ascontiguousarray(array, dtype=array.dtype.newbyteorder("<")).tobytes()
        padded = data + bytes(-len(data) % _ALIGNMENT)
        places[name] = {"dtype": array.dtype.name, "shape": array.shape, "offset": offset}
        parts.append(padded)
        offset += len(padded)
    text = json.dumps(plain({**header, "arrays": places}), allow_nan=False).encode()
    text += b" " * (-(len(text) + 4) % _ALIGNMENT)
    return b"".join([len(text).to_bytes(4, "little"), text, *parts])


def shares(probabilities: NDArray[np.float32]) -> NDArray[np.uint16]:
    """Return probabilities as whole numbers of 1 / 65535: half the size, with an error below 0.001 %."""
    whole: NDArray[np.uint16] = np.rint(probabilities * np.float32(65535)).astype(np.uint16)
    return whole


def plain(value: Any) -> Any:
    """Return a copy that JSON can hold: infinity becomes the text "inf", NaN None, and tuples become lists."""
    if isinstance(value, float):
        return "inf" if value == math.inf else value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(key): plain(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [plain(each) for each in value]
    if isinstance(value, np.generic):
        return plain(value.item())
    return value


# Largest number of states of a plan that is solved during a drag; 1.2 million take about 50 ms on two processors.
_DRAFT_STATES = 1_500_000

Request = dict[str, Any]
"""The JSON object of a request."""


def scenario_of(request: Request) -> Scenario:
    """Return the scenario of a request. Raises ScenarioError with all mistakes."""
    raw = request.get("scenario")
    if not isinstance(raw, dict):
        raise InputError(Mistake("scenario", "", "must be an object with the tables of a scenario file"))
    try:
        text = toml_text(_with_infinity(raw))
    except (TypeError, RecursionError) as error:
        raise InputError(Mistake("scenario", "", f"cannot be written as TOML: {error}")) from None
    return Scenario.from_toml(text)


def _with_infinity(value: Any, key: str = "") -> Any:
    """Return a copy in which radii that are the text "inf" are infinite, since JSON has no infinity."""
    if isinstance(value, dict):
        return {name: _with_infinity(each, name) for name, each in value.items() if each is not None}
    if isinstance(value, list):
        return [_with_infinity(each) for each in value]
    return math.inf if value == "inf" and key == "curvature_radius_mm" else value


def draft_of(scenario: Scenario) -> Scenario:
    """Return the scenario on a grid that is coarse enough to be solved during a drag, without refinements."""
    grid = replace(scenario.grid, refinement=1, success_refinement=1)
    coarser = math.sqrt(max(scenario.states / _DRAFT_STATES, 1))
    size = scenario.workspace
    dx, dy = grid.spacing_mm
    if coarser > 1:
        spacing = min(dx * coarser, size.width_mm), min(dy * coarser, size.height_mm)
        grid = replace(grid, spacing_mm=spacing)
    return scenario if grid == scenario.grid else replace(scenario, grid=grid)


# Best entries by table and edge; the search takes as long as a plan.
_entries: WeakKeyDictionary[PolicyTable, dict[str, Entry[Pose]]] = WeakKeyDictionary()


def _best_entry(table: PolicyTable, edge: str) -> Entry[Pose]:
    known = _entries.setdefault(table, {})
    if edge not in known:
        known[edge] = table.best_entry(edge)
    return known[edge]


def best_success(request: Request, table: PolicyTable) -> float:
    """Return the success by the table from the best entry on the edge of a request. The search takes 25 ms."""
    return _best_entry(table, str(request.get("edge", "left"))).success


def start_of(request: Request, table: PolicyTable, *, is_draft: bool = False) -> tuple[Pose, bool]:
    """Return the pose at which a request begins, and whether it is the best entry, as in a request without a start.

    In a draft, the best entry is that of the table's states, without a look one step ahead, which takes 25 ms.
    """
    start = request.get("start")
    if start is None:
        edge = str(request.get("edge", "left"))
        return table.best_entry(edge, nearest=True).pose if is_draft else _best_entry(table, edge).pose, True
    try:
        x_mm, y_mm, heading_deg = (float(start[key]) for key in ("x_mm", "y_mm", "heading_deg"))
        bevel = start.get("bevel")
    except (TypeError, KeyError, ValueError, AttributeError):
        raise PoseError(Mistake("start", "", "must have x_mm, y_mm and heading_deg, and may have a bevel")) from None
    return table.start(Pose.deg(x_mm, y_mm, heading_deg, bevel)), False


STATIC = Path(__file__).parent / "static"
"""Folder of the files of the page."""

# Prefix of the names under which the modules of an exported page import each other.
_PREFIX = "needleplan/"


def page_html(data: Mapping[str, Any], document: str = "index.html", module: str = "view.js") -> bytes:
    """Return the page as one HTML file that shows `data`, as `offline.js` reads it, without a server.

    `document` is the file of the page, and `module` its main module. The modules become data addresses of an import
    map, because browsers load no module from a neighbouring file.
    """
    imports = json.dumps({"imports": {f"{_PREFIX}{name}": _address(text) for name, text in _modules().items()}})
    entry = f'import "{_PREFIX}{module}";'
    style = (STATIC / "view.css").read_text(encoding="utf-8")
    icon = base64.b64encode((STATIC / "icon.svg").read_bytes()).decode()
    sources = " ".join(_digest(text) for text in (imports, entry))
    policy = f"default-src 'none'; script-src {sources} data:; style-src {_digest(style)}; img-src data: blob:"
    head = f"""<meta http-equiv="Content-Security-Policy" content="{policy}">
<link rel="icon" href="data:image/svg+xml;base64,{icon}">
<style>{style}</style>
<script type="importmap">{imports}</script>"""
    content = json.dumps(plain(data), allow_nan=False).replace("<", "\\u003c")
    tail = f"""<script type="application/json" id="data">{content}</script>
<script type="module">{entry}</script>
</body>"""
    page = (STATIC / document).read_text(encoding="utf-8")
    page = re.sub(r'<link rel="(icon|stylesheet|modulepreload)".*\n|<script type="module".*\n', "", page)
    page = page.replace("</head>", f"{head}\n</head>").replace("</body>", tail)
    return page.encode()


def _modules() -> dict[str, str]:
    """Return the texts of the modules by name, with imports by name, and without a server."""
    texts = {file.name: file.read_text(encoding="utf-8") for file in sorted(STATIC.glob("*.js"))}
    texts["net.js"] = texts.pop("offline.js")
    return {name: re.sub(r'from "\./', f'from "{_PREFIX}', text) for name, text in texts.items()}


def _address(text: str) -> str:
    return f"data:text/javascript;base64,{base64.b64encode(text.encode()).decode()}"


def _digest(text: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"
