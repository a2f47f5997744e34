"""The atlas file, `needleplan.atlas/1`: text to combinations and back."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from typing import Any

from needleplan.errors import Mistake, ModelError
from needleplan.estimation.atlas.combination import Combination
from needleplan.models.force import DepthForce, ForceModel1, ForceModel2
from needleplan.scenario.document import document
from needleplan.scenario.rules import Number, Pair, Refused, Rule, Text, sequence, shown, suggestion

__all__ = ["SCHEMA", "parse", "text"]

SCHEMA = "needleplan.atlas/1"

_MODELS: dict[str, type[DepthForce]] = {each.name: each for each in (ForceModel1, ForceModel2)}
_REQUIRED: dict[str, Rule] = {
    "needle": Text(),
    "tissue": Text(),
    "velocity_mm_s": Number("mm/s", above=0),
    "depth_mm": Number("mm", above=0),
    "source": Text(),
}
_OPTIONAL: dict[str, Rule] = {"mae_n": Number("N", at_least=0)}
_KEYS = (*_REQUIRED, *_OPTIONAL, "model", "digests", "parameters", "intervals")


def parse(content: str) -> tuple[str, tuple[Combination, ...], list[Mistake]]:
    """Return title, the combinations that could be read, and all mistakes."""
    given, mistakes = document(content, SCHEMA, ("schema", "title", "combination"))
    if given is None:
        return "", (), mistakes
    title = _read(Text(), given.get("title", ""), "title", mistakes)
    raw = given.get("combination", [])
    if not isinstance(raw, list):
        return "", (), [*mistakes, Mistake("combination", shown(raw), "must be tables, each below [[combination]]")]
    made = [_combination(each, f"combination {number}", mistakes) for number, each in enumerate(raw, start=1)]
    return str(title or ""), tuple(each for each in made if each), mistakes


def text(title: str, combinations: Sequence[Combination]) -> str:
    """Return the text of an atlas file."""
    lines = [f'schema = "{SCHEMA}"', f"title = {_quoted(title)}"]
    for each in combinations:
        lines += ["", "[[combination]]", *_entries(each)]
    return "\n".join(lines) + "\n"


def _combination(raw: object, key: str, mistakes: list[Mistake]) -> Combination | None:
    if not isinstance(raw, dict):
        mistakes.append(Mistake(key, shown(raw), "must be a table"))
        return None
    found: list[Mistake] = [
        Mistake(f"{key}.{name}", shown(raw[name]), f"unknown key{suggestion(name, _KEYS)}")
        for name in raw
        if name not in _KEYS
    ]
    values: dict[str, Any] = {}
    for name, rule in (*_REQUIRED.items(), *_OPTIONAL.items()):
        if name in raw:
            values[name] = _read(rule, raw[name], f"{key}.{name}", found)
        elif name in _REQUIRED:
            found.append(Mistake(f"{key}.{name}", "", "is missing"))
    model = _model(raw, key, found)
    values["intervals"] = _intervals(raw.get("intervals", {}), f"{key}.intervals", found)
    values["digests"] = _digests(raw.get("digests", []), f"{key}.digests", found)
    mistakes += found
    if found or model is None:
        return None
    try:
        return Combination(**values, model=model)
    except ModelError as error:
        mistakes += [Mistake(f"{key}.{each.key}", each.value, each.rule) for each in error.mistakes]
        return None


def _model(raw: dict[str, Any], key: str, mistakes: list[Mistake]) -> DepthForce | None:
    name = raw.get("model")
    if not isinstance(name, str) or name not in _MODELS:
        allowed = ", ".join(f'"{each}"' for each in _MODELS)
        value = "" if name is None else shown(name)
        mistakes.append(Mistake(f"{key}.model", value, f"must be one of {allowed}{suggestion(name, _MODELS)}"))
        return None
    kind = _MODELS[name]
    known = kind.parameters()
    given = raw.get("parameters", {})
    if not isinstance(given, dict):
        mistakes.append(Mistake(f"{key}.parameters", shown(given), "must be a table"))
        return None
    found = [
        Mistake(f"{key}.parameters.{each}", shown(given[each]), f"unknown parameter{suggestion(each, known)}")
        for each in given
        if each not in known
    ]
    values: dict[str, Any] = {}
    for each, what in known.items():
        place = f"{key}.parameters.{each}"
        if each not in given:
            found.append(Mistake(place, "", f"is missing: {what.about}"))
        else:
            values[each] = _read(Number(what.unit, at_least=what.lower, at_most=what.upper), given[each], place, found)
    mistakes += found
    return None if found else kind(**values)


def _intervals(raw: object, key: str, mistakes: list[Mistake]) -> dict[str, tuple[float, float]]:
    if not isinstance(raw, dict):
        mistakes.append(Mistake(key, shown(raw), "must be a table of [low, high]"))
        return {}
    read = {name: _read(Pair(Number()), value, f"{key}.{name}", mistakes) for name, value in raw.items()}
    return {name: pair for name, pair in read.items() if pair is not None}


def _digests(raw: object, key: str, mistakes: list[Mistake]) -> tuple[str, ...]:
    entries = sequence(raw)
    if entries is None or not all(isinstance(each, str) and each.startswith("sha256:") for each in entries):
        mistakes.append(Mistake(key, shown(raw), 'must be texts of the form "sha256:..."'))
        return ()
    return tuple(str(each) for each in entries)


def _read(rule: Rule, value: object, key: str, mistakes: list[Mistake]) -> Any:
    try:
        return rule.read(value)
    except Refused as refused:
        mistakes.append(Mistake(key, shown(value), str(refused)))
        return None


def _entries(each: Combination) -> Iterator[str]:
    for name in ("needle", "tissue"):
        yield f"{name} = {_quoted(getattr(each, name))}"
    yield f"velocity_mm_s = {float(each.velocity_mm_s)!r}"
    yield f"depth_mm = {float(each.depth_mm)!r}"
    yield f'model = "{each.model.name}"'
    if each.mae_n is not None:
        yield f"mae_n = {float(each.mae_n)!r}"
    yield f"source = {_quoted(each.source)}"
    if each.digests:
        yield f"digests = [{', '.join(_quoted(digest) for digest in each.digests)}]"
    known = each.model.parameters()
    inner = (f"{name} = {value!r}  # {known[name].unit}" for name, value in each.model.values().items())
    yield from ("", "[combination.parameters]", *inner)
    if each.intervals:
        pairs = (f"{name} = [{float(low)!r}, {float(high)!r}]" for name, (low, high) in each.intervals.items())
        yield from ("", "[combination.intervals]", *pairs)


def _quoted(value: str) -> str:
    # The strings of JSON are those of TOML but for one character.
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007F")
