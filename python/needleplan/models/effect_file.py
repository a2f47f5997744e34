"""The part of a model file that holds effects: one `[[effect]]` each, with its parameters as those of the model.

::

    [[effect]]
    name = "puncture"
    version = "1"
    found_by = "sha256:..."       # digest of the diagnosis that named it; empty where a person added it
    [effect.parameters.size]
    value = 0.31
    unit = "N"
    sd = 0.02                     # these four only where it was identified
    low = 0.27
    high = 0.35
    identified = true
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from needleplan.errors import ModelError
from needleplan.models._fit import Estimate
from needleplan.models.effects import AddedEffect, effect_named

__all__ = ["effect_lines", "read_effects"]

Wrong = Callable[[str, object, str], None]
_KEYS = ("name", "version", "found_by", "parameters")
_NUMBERS = ("value", "sd", "low", "high")


def effect_lines(added: AddedEffect) -> Iterator[str]:
    """Return the lines of an effect in a model file."""
    what = effect_named(added.name).parameters
    texts = {"name": added.name, "version": added.version, "found_by": added.found_by}
    yield from ("", "[[effect]]", *(f"{key} = {json.dumps(text)}" for key, text in texts.items()))
    for name, value in added.values.items():
        yield from (f"[effect.parameters.{name}]", f"value = {value!r}", f"unit = {json.dumps(what[name].unit)}")
        if name in added.estimates:
            each = added.estimates[name]
            yield from (f"{key} = {float(getattr(each, key))!r}" for key in _NUMBERS[1:])
            yield f"identified = {str(bool(each.identified)).lower()}"


def read_effects(raw: object, wrong: Wrong) -> tuple[AddedEffect, ...]:
    """Return the effects that a document holds; every mistake goes to `wrong` as key, value and rule."""
    if not isinstance(raw, list) or not all(isinstance(each, dict) for each in raw):
        wrong("effect", raw, "must be tables, each below its own [[effect]]")
        return ()
    found = [_effect(each, f"effect {number}", wrong) for number, each in enumerate(raw, start=1)]
    return tuple(each for each in found if each is not None)


def _effect(raw: Mapping[str, Any], key: str, wrong: Wrong) -> AddedEffect | None:
    good = _known(raw, _KEYS, key, wrong)
    texts = {each: raw.get(each, "1" if each == "version" else "") for each in _KEYS[:3]}
    for each, text in texts.items():
        if not isinstance(text, str):
            wrong(f"{key}.{each}", text, "must be a text")
            good = False
    parameters = raw.get("parameters", {})
    if not isinstance(parameters, dict) or not all(isinstance(each, dict) for each in parameters.values()):
        wrong(f"{key}.parameters", parameters, "must be tables with value and unit")
        good = False
    if not good:
        return None
    try:
        what = effect_named(texts["name"]).parameters
    except ModelError as error:
        for mistake in error.mistakes:
            wrong(f"{key}.name", mistake.value, mistake.rule)
        return None
    values: dict[str, float] = {}
    estimates: dict[str, Estimate] = {}
    for name, each in parameters.items():
        place = f"{key}.parameters.{name}"
        if name not in what:
            wrong(place, "", f"must be one of {', '.join(what)}")
            good = False
            continue
        good &= _known(each, (*_NUMBERS, "unit", "identified"), place, wrong)
        if each.get("unit") != what[name].unit:
            wrong(f"{place}.unit", each.get("unit", ""), f'must be "{what[name].unit}"')
            good = False
        numbers = {number: each.get(number) for number in (_NUMBERS if "sd" in each else _NUMBERS[:1])}
        if not all(map(_is_number, numbers.values())) or not isinstance(each.get("identified", True), bool):
            wrong(place, "", "must have a number as value, and with sd also low and high")
            good = False
            continue
        values[name] = float(each["value"])
        if "sd" in each:
            ends = (float(each["sd"]), float(each["low"]), float(each["high"]))
            estimates[name] = Estimate(values[name], *ends, what[name].unit, each.get("identified", True))
    if not good:
        return None
    try:
        return AddedEffect(texts["name"], values, estimates, texts["found_by"], texts["version"])
    except ModelError as error:
        for mistake in error.mistakes:
            wrong(f"{key}.parameters.{mistake.key}", mistake.value, mistake.rule)
        return None


def _known(raw: Mapping[str, Any], keys: tuple[str, ...], place: str, wrong: Wrong) -> bool:
    unknown = [each for each in raw if each not in keys]
    for each in unknown:
        wrong(f"{place}.{each}", "", "unknown key")
    return not unknown


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and not math.isnan(value)
