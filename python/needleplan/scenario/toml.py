"""The scenario file, `needleplan.scenario/1`: text to parts and back."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import fields
from typing import Any

from needleplan.errors import Mistake
from needleplan.scenario.document import document
from needleplan.scenario.parts import (
    Grid,
    Layer,
    Motion,
    Needle,
    Objective,
    Obstacle,
    Part,
    Solver,
    Target,
    Tissue,
    Workspace,
    checked,
)
from needleplan.scenario.rules import Refused, Text, shown

__all__ = ["SCHEMA", "parse", "text"]

SCHEMA = "needleplan.scenario/1"

_TABLES: dict[str, type[Part]] = {
    "workspace": Workspace,
    "target": Target,
    "needle": Needle,
    "motion": Motion,
    "grid": Grid,
    "objective": Objective,
    "solver": Solver,
}
_LISTS: dict[str, tuple[str, type[Part]]] = {"obstacle": ("obstacles", Obstacle), "tissue": ("tissues", Tissue)}
_KEYS = ("schema", "title", *_LISTS, *_TABLES)
_ORDER = ("workspace", "obstacle", "target", "needle", "tissue", "motion", "grid", "objective", "solver")


def parse(text: str) -> tuple[dict[str, Any], list[Mistake]]:
    """Return the parts that could be read, named as the fields of a scenario, and all mistakes."""
    given, mistakes = document(text, SCHEMA, _KEYS)
    if given is None:
        return {}, mistakes
    parts: dict[str, Any] = {}
    try:
        parts["title"] = Text().read(given.get("title", ""))
    except Refused as refused:
        mistakes.append(Mistake("title", shown(given["title"]), str(refused)))
    for name, part in _TABLES.items():
        raw, found = _unnested(given.get(name, {})) if name == "needle" else (given.get(name, {}), [])
        made, more = _part(part, raw, name)
        mistakes += found + more
        if made and not found:
            parts[name] = made
    for name, (plural, part) in _LISTS.items():
        parts[plural], found = _list(part, given.get(name, []), name)
        mistakes += found
    return parts, mistakes


def text(parts: Mapping[str, Any]) -> str:
    """Return the text of a scenario file; `parts` are named as the fields of a scenario."""
    lines = [f'schema = "{SCHEMA}"', f"title = {_value(parts['title'])}"]
    for name in _ORDER:
        if name in _LISTS:
            for each in parts[_LISTS[name][0]]:
                lines += ["", f"[[{name}]]", *_entries(each)]
        else:
            lines += ["", f"[{name}]", *_entries(parts[name])]
        if name == "needle":
            for layer in parts[name].layers:
                lines += ["", "[[needle.layer]]", *_entries(layer)]
    return "\n".join(lines) + "\n"


def _unnested(raw: object) -> tuple[object, list[Mistake]]:
    """Return the table of the needle with its layers as parts."""
    if not isinstance(raw, dict) or "layer" not in raw:
        return raw, []
    layers, mistakes = _list(Layer, raw["layer"], "needle.layer")
    rest = {key: value for key, value in raw.items() if key != "layer"}
    return rest | {"layers": [layer for layer in layers if layer]}, mistakes


def _part(part: type[Part], raw: object, key: str) -> tuple[Part | None, list[Mistake]]:
    if not isinstance(raw, dict):
        return None, [Mistake(key, shown(raw), f"must be a table, [{key.split()[0]}]")]
    values, mistakes = checked(part, raw, key)
    return (None if mistakes else part(**values)), mistakes


def _list(part: type[Part], raw: object, key: str) -> tuple[tuple[Part | None, ...], list[Mistake]]:
    """Return the parts of a list of tables, None for those with mistakes, and the mistakes."""
    if not isinstance(raw, list):
        return (), [Mistake(key, shown(raw), f"must be tables, each below its own [[{key}]]")]
    parts: list[Part | None] = []
    mistakes: list[Mistake] = []
    for number, each in enumerate(raw, start=1):
        name = each.get("name") if isinstance(each, dict) else None
        title = f' ("{name}")' if isinstance(name, str) and name else ""
        made, found = _part(part, each, f"{key} {number}{title}")
        parts.append(made)
        mistakes += found
    return tuple(parts), mistakes


def _entries(part: Part) -> Iterator[str]:
    for each in fields(part):
        value = getattr(part, each.name)
        if value is not None and not each.metadata["key"]:
            yield f"{each.name} = {_value(value)}"


def _value(value: object) -> str:
    if isinstance(value, str):
        # The strings of JSON are those of TOML but for one character.
        return json.dumps(str(value), ensure_ascii=False).replace("\x7f", "\\u007F")
    if isinstance(value, tuple):
        return f"[{', '.join(_value(entry) for entry in value)}]"
    return repr(value)
