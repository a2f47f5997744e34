"""The registration file, `needleplan.registration/1`: text to values and back."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from needleplan.errors import Mistake
from needleplan.scenario.document import document
from needleplan.scenario.rules import Integer, Number, Refused, Rule, Text, sequence, shown, suggestion

__all__ = ["SCHEMA", "Numbers", "Parent", "parse", "text"]

SCHEMA = "needleplan.registration/1"
_KEYS = ("schema", "title", "made_by", "coil", "frame", "point", "parent")


@dataclass(frozen=True)
class Parent:
    """A file that a registration was made from: its name for people, and its digest."""

    name: str
    digest: str


@dataclass(frozen=True)
class Numbers:
    """So many finite numbers."""

    count: int

    def read(self, value: object) -> tuple[float, ...]:
        """Return the numbers as a tuple. Raises Refused."""
        entries = sequence(value)
        if entries is None or len(entries) != self.count:
            raise Refused(f"must be {self.count} numbers")
        try:
            return tuple(Number().read(entry) for entry in entries)
        except Refused as refused:
            raise Refused(f"each of the {self.count} {refused}") from None


_COIL: dict[str, tuple[str, Rule]] = {
    "offset_mm": ("coil_offset_mm", Number("mm", at_least=0, at_most=500)),
    "offset_sd_mm": ("coil_offset_sd_mm", Number("mm", at_least=0, at_most=100)),
    "axis": ("coil_axis", Integer(-1, 1)),
    "rms_mm": ("pivot_rms_mm", Number("mm", at_least=0)),
    "poses": ("pivot_poses", Integer(0, 10**9)),
}
_FRAME: dict[str, tuple[str, Rule]] = {
    "quaternion": ("quaternion", Numbers(4)),
    "translation_mm": ("translation_mm", Numbers(3)),
}
_POINT: dict[str, tuple[str, Rule]] = {
    "tracker_mm": ("tracker_mm", Numbers(3)),
    "plan_mm": ("plan_mm", Numbers(3)),
}
_PARENT: dict[str, tuple[str, Rule]] = {"name": ("name", Text()), "digest": ("digest", Text())}


def parse(content: str) -> tuple[dict[str, Any], list[Mistake]]:
    """Return what could be read, named as the fields of a registration, and all mistakes."""
    given, mistakes = document(content, SCHEMA, _KEYS)
    if given is None:
        return {}, mistakes
    values: dict[str, Any] = {}
    for key in ("title", "made_by"):
        if key in given:
            values[key] = _value(Text(), given[key], key, mistakes)
    values |= _table(given.get("coil"), _COIL, "coil", mistakes)
    values |= _table(given.get("frame"), _FRAME, "frame", mistakes)
    points = _rows(given.get("point", []), _POINT, "point", mistakes)
    parents = _rows(given.get("parent", []), _PARENT, "parent", mistakes)
    if not mistakes:
        values["points"] = tuple((each["tracker_mm"], each["plan_mm"]) for each in points)
        values["parents"] = tuple(Parent(**each) for each in parents)
    return values, mistakes


def text(values: Mapping[str, Any]) -> str:
    """Return the text of a registration file, from the fields of a registration."""
    return "\n".join(_lines(values)) + "\n"


def _lines(values: Mapping[str, Any]) -> Iterator[str]:
    yield f'schema = "{SCHEMA}"'
    yield from (f"{key} = {_quoted(values[key])}" for key in ("title", "made_by"))
    for name, table in (("coil", _COIL), ("frame", _FRAME)):
        yield from ("", f"[{name}]")
        yield from (f"{key} = {_number(values[of])}" for key, (of, _) in table.items())
    for tracker, plan in values["points"]:
        yield from ("", "[[point]]", f"tracker_mm = {_number(tracker)}", f"plan_mm = {_number(plan)}")
    for each in values["parents"]:
        yield from ("", "[[parent]]", f"name = {_quoted(each.name)}", f"digest = {_quoted(each.digest)}")


def _rows(raw: object, keys: dict[str, tuple[str, Rule]], name: str, mistakes: list[Mistake]) -> list[dict[str, Any]]:
    if not isinstance(raw, list):
        mistakes.append(Mistake(name, shown(raw), f"must be tables, each below [[{name}]]"))
        return []
    return [_table(each, keys, f"{name} {number}", mistakes) for number, each in enumerate(raw, start=1)]


def _table(raw: object, keys: dict[str, tuple[str, Rule]], name: str, mistakes: list[Mistake]) -> dict[str, Any]:
    if not isinstance(raw, dict):
        rule = "must be a table" if raw is not None else "is missing"
        mistakes.append(Mistake(name, "" if raw is None else shown(raw), rule))
        return {}
    mistakes += [Mistake(f"{name}.{key}", "", f"unknown key{suggestion(key, keys)}") for key in raw if key not in keys]
    mistakes += [Mistake(f"{name}.{key}", "", "is missing") for key in keys if key not in raw]
    return {of: _value(rule, raw[key], f"{name}.{key}", mistakes) for key, (of, rule) in keys.items() if key in raw}


def _value(rule: Rule, value: object, key: str, mistakes: list[Mistake]) -> Any:
    try:
        return rule.read(value)
    except Refused as refused:
        mistakes.append(Mistake(key, shown(value), str(refused)))
        return None


def _number(value: float | tuple[float, ...]) -> str:
    return f"[{', '.join(map(repr, value))}]" if isinstance(value, tuple) else repr(value)


def _quoted(value: str) -> str:
    # The strings of JSON are those of TOML but for one character.
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007F")
