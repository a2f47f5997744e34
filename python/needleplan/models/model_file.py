"""The model file, `needleplan.model/1`: an identified model as TOML.

::

    schema = "needleplan.model/1"
    kind = "bicycle"
    title = ""
    made_by = "needleplan 0.1.0"

    [parameters.curvature_per_mm]
    value = 0.00083
    unit = "1/mm"
    sd = 2e-5                 # these four only where it was identified
    low = 0.00079
    high = 0.00087
    identified = true

    [options]                 # what is not a number: which variant of the model
    profile = "constant"

    [[parent]]                # what it was identified from
    name = "trial 3"
    digest = "sha256:..."

    [[effect]]                # what was added to the model: see `needleplan.models.effect_file`

Parameters that the file does not name have the default of the model; `unit` must be that of the model.
"""

from __future__ import annotations

import json
import math
import os
import tomllib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import MISSING, Field, dataclass, field, fields
from difflib import get_close_matches
from enum import StrEnum
from functools import cached_property
from pathlib import Path
from typing import Any, get_type_hints

from needleplan.artifacts import digest, version, write_whole
from needleplan.errors import Mistake, ModelError
from needleplan.models._base import Model, Parameter
from needleplan.models._fit import Estimate
from needleplan.models._kinds import kind_of
from needleplan.models.effect_file import effect_lines, read_effects
from needleplan.models.effects import AugmentedModel

__all__ = ["SCHEMA", "ModelFile", "Parent"]

SCHEMA = "needleplan.model/1"
_KEYS = ("schema", "kind", "title", "made_by", "parameters", "options", "parent", "remarks", "effect")
_NUMBERS = ("value", "sd", "low", "high")
_ESTIMATE = ("sd", "low", "high", "identified")
_OPTIONS = (StrEnum, bool, int, float, str)


@dataclass(frozen=True)
class Parent:
    """What a model was identified from: a name for people, and the digest of the file, empty where there is none."""

    name: str
    digest: str


@dataclass(frozen=True)
class ModelFile:
    """A model with the intervals of its parameters, where it came from, and what was remarked about it."""

    model: Model
    estimates: Mapping[str, Estimate] = field(default_factory=dict)
    parents: tuple[Parent, ...] = ()
    remarks: tuple[str, ...] = ()
    title: str = ""
    made_by: str = field(default_factory=lambda: f"needleplan {version()}")

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> ModelFile:
        """Read a model file. Raises ModelError with every mistake of the file."""
        source = os.fspath(path)
        try:
            text = Path(path).read_bytes().decode()
        except UnicodeDecodeError:
            raise ModelError("is not UTF-8", source) from None
        except (OSError, ValueError) as error:
            reason = getattr(error, "strerror", None) or error
            raise ModelError(f"cannot be read: {reason}", source) from error
        return cls.from_toml(text, source)

    @classmethod
    def from_toml(cls, text: str, source: str = "") -> ModelFile:
        """Return what the text of a model file says. Raises ModelError with every mistake of the text."""
        try:
            document = tomllib.loads(text)
        except (ValueError, RecursionError) as error:
            raise ModelError(f"is not TOML: {error}", source) from None
        reader = _Reader(document)
        found = reader.read()
        if found is None or reader.mistakes:
            raise ModelError(reader.mistakes, source)
        return found

    def to_toml(self) -> str:
        """Return the text of a model file that reads back as exactly this."""
        return "\n".join(self._lines()) + "\n"

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write a model file. Raises OutputError."""
        write_whole(path, self.to_toml().encode())

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the text, by which what is made from the model names it."""
        return digest(self.to_toml())

    def _lines(self) -> Iterator[str]:
        effects = self.model.effects if isinstance(self.model, AugmentedModel) else ()
        model = self.model.base if isinstance(self.model, AugmentedModel) else self.model
        kind = type(model)
        yield from (f"schema = {_text(SCHEMA)}", f"kind = {_text(kind.name)}", f"title = {_text(self.title)}")
        yield f"made_by = {_text(self.made_by)}"
        yield f"remarks = [{', '.join(map(_text, self.remarks))}]"
        for name, what in kind.parameters().items():
            yield from (
                "",
                f"[parameters.{name}]",
                f"value = {getattr(model, name)!r}",
                f"unit = {_text(what.unit)}",
            )
            if name in self.estimates:
                each = self.estimates[name]
                yield from (f"{key} = {_number(getattr(each, key))}" for key in ("sd", "low", "high"))
                yield f"identified = {str(bool(each.identified)).lower()}"
        options = _options(kind)
        if options:
            yield from ("", "[options]")
            yield from (f"{name} = {_option(getattr(model, name))}" for name in options)
        for parent in self.parents:
            yield from ("", "[[parent]]", f"name = {_text(parent.name)}", f"digest = {_text(parent.digest)}")
        for added in effects:
            yield from effect_lines(added)


class _Reader:
    """Reads a document and collects its mistakes."""

    def __init__(self, document: Mapping[str, Any]) -> None:
        self.document = document
        self.mistakes: list[Mistake] = []

    def read(self) -> ModelFile | None:
        self._unknown("", self.document, _KEYS)
        if self.document.get("schema") != SCHEMA:
            self._wrong("schema", self.document.get("schema", ""), f'must be "{SCHEMA}"')
        texts = {key: self._string(key, self.document.get(key, "")) for key in ("kind", "title", "made_by")}
        remarks = self._strings("remarks")
        parents = tuple(self._parents())
        try:
            kind = kind_of(texts["kind"])
        except ModelError as error:
            self.mistakes += error.mistakes
            return None
        parameters = self._table("parameters")
        known = kind.parameters()
        self._unknown("parameters", parameters, known)
        effects = read_effects(self.document.get("effect", []), self._wrong)
        values: dict[str, Any] = self._choices(kind)
        estimates: dict[str, Estimate] = {}
        for name, what in known.items():
            if name in parameters:
                self._parameter(name, what, parameters[name], values, estimates)
            elif _default(kind, name) is MISSING:
                self._wrong(f"parameters.{name}", "", "is missing")
        if self.mistakes:
            return None
        try:
            model: Model = kind(**values)
        except ModelError as error:
            self.mistakes += [Mistake(f"parameters.{each.key}", each.value, each.rule) for each in error.mistakes]
            return None
        if effects:
            model = AugmentedModel(model, effects)
        return ModelFile(model, estimates, parents, remarks, texts["title"], texts["made_by"])

    def _parameter(
        self, name: str, what: Parameter, raw: object, values: dict[str, Any], estimates: dict[str, Estimate]
    ) -> None:
        key = f"parameters.{name}"
        if not isinstance(raw, dict):
            self._wrong(key, raw, f"must be a table with value and unit, [{key}]")
            return
        self._unknown(key, raw, ("value", "unit", *_ESTIMATE))
        before = len(self.mistakes)
        if raw.get("unit") != what.unit:
            self._wrong(f"{key}.unit", raw.get("unit", ""), f'must be "{what.unit}"')
        for number in _NUMBERS:
            each = raw.get(number)
            if each is None and (number == "value" or "sd" in raw):
                self._wrong(f"{key}.{number}", "", "is missing")
            elif each is not None and (isinstance(each, bool) or not isinstance(each, int | float) or math.isnan(each)):
                self._wrong(f"{key}.{number}", each, f"must be a number in {what.unit or '1'}")
        if not isinstance(raw.get("identified", True), bool):
            self._wrong(f"{key}.identified", raw["identified"], "must be true or false")
        if len(self.mistakes) > before:
            return
        values[name] = float(raw["value"])
        if "sd" in raw:
            low, high = float(raw["low"]), float(raw["high"])
            if not (low <= values[name] <= high and raw["sd"] >= 0):
                self._wrong(
                    f"{key}.low, high", f"{low:g}, {high:g}", "must hold the value between them, and sd be 0 or more"
                )
            identified = raw.get("identified", True)
            estimates[name] = Estimate(values[name], float(raw["sd"]), low, high, what.unit, identified)

    def _choices(self, kind: type[Model]) -> dict[str, Any]:
        raw, known = self._table("options"), _options(kind)
        self._unknown("options", raw, known)
        values: dict[str, Any] = {}
        for name, its_type in known.items():
            if name not in raw:
                if _default(kind, name) is MISSING:
                    self._wrong(f"options.{name}", "", "is missing")
                continue
            value = raw[name]
            if issubclass(its_type, StrEnum):
                if value in list(its_type):
                    values[name] = its_type(value)
                else:
                    self._wrong(f"options.{name}", value, f"must be one of {', '.join(its_type)}")
            elif isinstance(value, bool) is (its_type is bool) and isinstance(value, its_type | int):
                values[name] = its_type(value)
            else:
                self._wrong(f"options.{name}", value, f"must be of the type {its_type.__name__}")
        return values

    def _parents(self) -> Iterator[Parent]:
        raw = self.document.get("parent", [])
        if not isinstance(raw, list) or not all(isinstance(each, dict) for each in raw):
            self._wrong("parent", raw, "must be tables, each below its own [[parent]]")
            return
        for number, each in enumerate(raw, start=1):
            self._unknown(f"parent {number}", each, ("name", "digest"))
            texts = {key: self._string(f"parent {number}.{key}", each.get(key, "")) for key in ("name", "digest")}
            yield Parent(**texts)

    def _table(self, key: str) -> dict[str, Any]:
        raw = self.document.get(key, {})
        if isinstance(raw, dict):
            return raw
        self._wrong(key, raw, f"must be a table, [{key}]")
        return {}

    def _strings(self, key: str) -> tuple[str, ...]:
        raw = self.document.get(key, [])
        if isinstance(raw, list) and all(isinstance(each, str) for each in raw):
            return tuple(raw)
        self._wrong(key, raw, "must be a list of texts")
        return ()

    def _string(self, key: str, raw: object) -> str:
        if isinstance(raw, str):
            return raw
        self._wrong(key, raw, "must be a text")
        return ""

    def _unknown(self, key: str, raw: Mapping[str, Any], known: Iterable[str]) -> None:
        for name in raw:
            if name not in known:
                close = get_close_matches(name, list(known), n=1)
                rule = "unknown key" + (f'; did you mean "{close[0]}"?' if close else "")
                self._wrong(f"{key}.{name}".lstrip("."), "", rule)

    def _wrong(self, key: str, value: object, rule: str) -> None:
        self.mistakes.append(Mistake(key, str(value), rule))


def _fields(kind: type[Model]) -> dict[str, Field[Any]]:
    return {each.name: each for each in fields(kind)}


def _default(kind: type[Model], name: str) -> object:
    each = _fields(kind)[name]
    return each.default if each.default is not MISSING else each.default_factory


def _options(kind: type[Model]) -> dict[str, type[Any]]:
    """Return the fields that are not parameters, with their type: enumerations, truth values, numbers, texts."""
    hints = get_type_hints(kind)
    found = {name: hints[name] for name in _fields(kind) if name not in kind.parameters()}
    for name, hint in found.items():
        if not (isinstance(hint, type) and issubclass(hint, _OPTIONS)):
            raise TypeError(f"{kind.__name__}.{name}: a model file cannot hold {hint}")
    return found


def _option(value: object) -> str:
    return (
        _text(str(value)) if isinstance(value, str) else str(value).lower() if isinstance(value, bool) else repr(value)
    )


def _number(value: float) -> str:
    return repr(float(value))


def _text(value: str) -> str:
    # The strings of JSON are those of TOML but for one character.
    return json.dumps(str(value), ensure_ascii=False).replace("\x7f", "\\u007F")
