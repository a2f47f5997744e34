"""The scenario file, `needleplan.scenario/1`: text to parts and back."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import fields
from typing import Any

from needleplan.errors import Mistake
from needleplan.scenario.parts import (
    Grid,
    Motion,
    Needle,
    Objective,
    Obstacle,
    Part,
    Solver,
    Target,
    Workspace,
    checked,
)
from needleplan.scenario.rules import Refused, Text, shown, suggestion

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
_KEYS = ("schema", "title", "obstacle", *_TABLES)


def parse(text: str) -> tuple[dict[str, Any], list[Mistake]]:
    """Return the parts that could be read, named as the fields of a scenario, and all mistakes."""
    try:
        document = tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        return {}, [Mistake("", "", f"is not TOML: {error}")]
    mistakes = [Mistake(key, "", f"unknown key{suggestion(key, _KEYS)}") for key in document if key not in _KEYS]
    if document.get("schema") != SCHEMA:
        mistakes.insert(0, Mistake("schema", shown(document.get("schema", "")), f'must be "{SCHEMA}"'))
    parts: dict[str, Any] = {}
    try:
        parts["title"] = Text().read(document.get("title", ""))
    except Refused as refused:
        mistakes.append(Mistake("title", shown(document["title"]), str(refused)))
    for name, part in _TABLES.items():
        made, found = _part(part, document.get(name, {}), name)
        mistakes += found
        if made:
            parts[name] = made
    parts["obstacles"], found = _obstacles(document.get("obstacle", []))
    return parts, mistakes + found


def text(parts: Mapping[str, Any]) -> str:
    """Return the text of a scenario file; `parts` are named as the fields of a scenario."""
    lines = [f'schema = "{SCHEMA}"', f"title = {_value(parts['title'])}"]
    for name in ("workspace", "obstacle", *(name for name in _TABLES if name != "workspace")):
        if name == "obstacle":
            for obstacle in parts["obstacles"]:
                lines += ["", "[[obstacle]]", *_entries(obstacle)]
        else:
            lines += ["", f"[{name}]", *_entries(parts[name])]
    return "\n".join(lines) + "\n"


def _part(part: type[Part], raw: object, key: str) -> tuple[Part | None, list[Mistake]]:
    if not isinstance(raw, dict):
        return None, [Mistake(key, shown(raw), f"must be a table, [{key.split()[0]}]")]
    values, mistakes = checked(part, raw, key)
    return (None if mistakes else part(**values)), mistakes


def _obstacles(raw: object) -> tuple[tuple[Part | None, ...], list[Mistake]]:
    if not isinstance(raw, list):
        return (), [Mistake("obstacle", shown(raw), "must be tables, each below its own [[obstacle]]")]
    obstacles: list[Part | None] = []
    mistakes: list[Mistake] = []
    for number, each in enumerate(raw, start=1):
        name = each.get("name") if isinstance(each, dict) else None
        title = f' ("{name}")' if isinstance(name, str) and name else ""
        obstacle, found = _part(Obstacle, each, f"obstacle {number}{title}")
        obstacles.append(obstacle)
        mistakes += found
    return tuple(obstacles), mistakes


def _entries(part: Part) -> Iterator[str]:
    for each in fields(part):
        value = getattr(part, each.name)
        if value is not None:
            yield f"{each.name} = {_value(value)}"


def _value(value: object) -> str:
    if isinstance(value, str):
        # The strings of JSON are those of TOML but for one character.
        return json.dumps(str(value), ensure_ascii=False).replace("\x7f", "\\u007F")
    if isinstance(value, tuple):
        return f"[{', '.join(_value(entry) for entry in value)}]"
    return repr(value)
