"""Tables: frozen dataclasses with one rule per field, read from the tables of a file or built by a constructor."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import MISSING, Field, dataclass, field, fields
from functools import cache
from typing import Any, ClassVar, TypeVar

from needleplan.artifacts import Parent
from needleplan.config._rules import Choice, Rule, Text, Violation, sequence, suggestion
from needleplan.errors import InputError, Mistake

__all__ = [
    "ConfigTable",
    "Given",
    "Keyed",
    "ParentList",
    "Subtable",
    "TableList",
    "build",
    "examine",
    "key_of",
    "ruled",
    "under",
]

Between = Callable[..., Iterable[Mistake]]
_T = TypeVar("_T", bound="ConfigTable")


def ruled(
    rule: Rule | Given, default: object = MISSING, *, factory: Any = MISSING, key: str = "", about: str = ""
) -> Any:
    """Declare a field whose values are read by `rule`.

    `key` is the key in a file if it differs from the name of the field. `about` is the comment in commented files.
    """
    metadata = {"rule": rule, "key": key, "about": about}
    if factory is not MISSING:
        return field(default_factory=factory, metadata=metadata)
    return field(default=default, metadata=metadata)


@dataclass(frozen=True)
class Given:
    """The rule of a field whose form depends on the value of an earlier field, such as the parameters of a `kind`.

    The field is not read if the earlier field has a mistake.
    """

    field: str
    rule: Callable[[Any], Rule]


@dataclass(frozen=True)
class ConfigTable:
    """Base class of TOML tables as frozen dataclasses.

    Every field is declared by `ruled`. The constructor and the reading of a file check the same rules. Class arguments:

    - `key`: name of the table in messages and headers, such as `needle.layer`
    - `error`: exception that reports the mistakes
    - `schema`: value of the key `schema`, if the table is the top level of a file
    - `between`: rules between fields. The parameters of such a function are names of fields. It yields mistakes and is
      called if all these fields could be read.
    """

    key: ClassVar[str] = ""
    error: ClassVar[type[InputError]] = InputError
    schema: ClassVar[str] = ""
    between: ClassVar[tuple[Between, ...]] = ()

    def __init_subclass__(
        cls,
        *,
        key: str | None = None,
        error: type[InputError] | None = None,
        schema: str | None = None,
        between: tuple[Between, ...] | None = None,
    ) -> None:
        super().__init_subclass__()
        for name, value in (("key", key), ("error", error), ("schema", schema), ("between", between)):
            if value is not None:
                setattr(cls, name, value)

    def __post_init__(self) -> None:
        try:
            _fill(self, {key_of(each): getattr(self, each.name) for each in fields(self)})
        except Violation as broken:
            raise self.error(list(under(self.key, broken.mistakes))) from None

    def contradictions(self) -> Iterable[Mistake]:
        """Return the mistakes of the table as a whole, with keys relative to it; called if all fields are valid."""
        return ()


def examine(kind: type[ConfigTable], raw: Mapping[str, object]) -> tuple[dict[str, Any], list[Mistake]]:
    """Return the values of the fields, defaults included, and all mistakes of a raw table.

    `raw` maps the keys of a file to raw values. Keys of mistakes are relative to the table. Fields with mistakes have
    no value, except lists of tables: their broken entries are None.
    """
    known = {key_of(each): each for each in fields(kind)}
    keys = [*known, "schema"] if kind.schema else list(known)
    mistakes = [Mistake(key, "", f"unknown key{suggestion(key, keys)}") for key in raw if key not in known]
    values: dict[str, Any] = {}
    for key, each in known.items():
        rule = each.metadata["rule"]
        if isinstance(rule, Given):
            if values.get(rule.field) is None:
                continue
            rule = rule.rule(values[rule.field])
        if key in raw:
            value = raw[key]
        elif each.default is not MISSING:
            values[each.name] = each.default
            continue
        elif each.default_factory is not MISSING:
            values[each.name] = each.default_factory()
            continue
        elif isinstance(rule, Subtable | Keyed):
            value = {}
        else:
            hint = f": must be {rule}" if isinstance(rule, TableList | Choice) else ""
            mistakes.append(Mistake(key, "", f"is missing{hint}"))
            continue
        try:
            values[each.name] = rule.read(value)
        except Violation as broken:
            mistakes += under(key, broken.mistakes)
            if broken.partial is not None:
                values[each.name] = broken.partial
    for between in kind.between:
        names = _names(between)
        if all(name in values for name in names):
            mistakes += between(*(values[name] for name in names))
    return values, mistakes


def build(kind: type[_T], raw: Mapping[str, object]) -> _T:
    """Return the dataclass instance for a raw table. Raises Violation with all mistakes, keys relative to the table."""
    made = object.__new__(kind)  # __post_init__ would check all rules a second time
    _fill(made, raw)
    return made


def under(key: str, mistakes: Iterable[Mistake]) -> Iterator[Mistake]:
    """Yield the mistakes with `key` in front of their keys: with `a`, key `b` becomes `a.b`, and ` 1.b` `a 1.b`."""
    for each in mistakes:
        dot = "." if key and each.key and not each.key.startswith(" ") else ""
        yield Mistake(f"{key}{dot}{each.key}", each.value, each.rule)


@dataclass(frozen=True)
class Subtable:
    """A table within a table. If it is missing and has no default, it is read as an empty table."""

    kind: type[ConfigTable]

    def read(self, value: object) -> Any:
        """Return the table. Raises Violation."""
        if isinstance(value, self.kind):
            return value
        if not isinstance(value, Mapping):
            raise Violation(f"must be a table, [{self.kind.key}]", value)
        return build(self.kind, value)


@dataclass(frozen=True)
class TableList:
    """Tables under the header `[[key]]`, at most `at_most`; keys of mistakes hold the number and name of the table."""

    kind: type[ConfigTable]
    at_most: int | None = None

    def read(self, value: object) -> tuple[Any, ...]:
        """Return the tables as a tuple. Raises Violation, with a partial tuple in which broken tables are None."""
        entries, header = sequence(value), f"[[{self.kind.key}]]"
        if entries is None or not all(isinstance(each, self.kind | Mapping) for each in entries):
            raise Violation(f"must be tables, each below its own {header}", value)
        if self.at_most is not None and len(entries) > self.at_most:
            raise Violation(f"must be at most {self.at_most} tables {header}, not {len(entries)}")
        found: list[Any] = []
        mistakes: list[Mistake] = []
        for number, entry in enumerate(entries, start=1):
            try:
                found.append(Subtable(self.kind).read(entry))
            except Violation as broken:
                name = entry.get("name") if isinstance(entry, Mapping) else None
                title = f' ("{name}")' if isinstance(name, str) and name else ""
                mistakes += under(f" {number}{title}", broken.mistakes)
                found.append(None)
        if mistakes:
            raise Violation(mistakes, partial=tuple(found))
        return tuple(found)

    def __str__(self) -> str:
        return f"at least one [[{self.kind.key}]]"


@dataclass(frozen=True)
class Keyed:
    """A table whose keys and rules are known only at run time; it is stored as a dict with the keys of the file.

    Keys in `required` must be present. If `others` is given, this rule reads all keys that are not in `rules`.
    """

    rules: Mapping[str, Rule]
    required: Mapping[str, str] = field(default_factory=dict)
    """Keys that must be present, each with an explanation for messages, which may be empty."""

    others: Rule | None = None

    def read(self, value: object) -> dict[str, Any]:
        """Return the values by key. Raises Violation."""
        if not isinstance(value, Mapping):
            raise Violation("must be a table", value)
        mistakes: list[Mistake] = []
        found: dict[str, Any] = {}
        for key in [*(key for key in value if key not in self.rules), *self.rules]:
            rule = self.rules.get(key, self.others)
            if key not in value:
                if key in self.required:
                    about = self.required[key]
                    mistakes.append(Mistake(key, "", f"is missing{': ' if about else ''}{about}"))
            elif rule is None:
                mistakes.append(Mistake(key, "", f"unknown key{suggestion(key, self.rules)}"))
            else:
                try:
                    found[key] = rule.read(value[key])
                except Violation as broken:
                    mistakes += under(key, broken.mistakes)
        if mistakes:
            raise Violation(mistakes)
        return found


@dataclass(frozen=True)
class _ParentTable(ConfigTable, key="parent"):
    """One table `[[parent]]`: name and digest of a file from which an artefact was made."""

    name: str = ruled(Text(100_000))
    digest: str = ruled(Text())


@dataclass(frozen=True)
class _PartialParentTable(_ParentTable):
    """One table `[[parent]]` whose keys may be missing."""

    name: str = ruled(Text(100_000), "")
    digest: str = ruled(Text(), "")


@dataclass(frozen=True)
class ParentList:
    """The parents of an artefact: tables `[[parent]]` with name and digest, which may be missing if `partial`."""

    partial: bool = False

    def read(self, value: object) -> tuple[Parent, ...]:
        """Return the parents. Raises Violation."""
        entries = sequence(value)
        if entries is not None and all(isinstance(each, Parent) for each in entries):
            return tuple(entries)  # type: ignore[arg-type]
        kind = _PartialParentTable if self.partial else _ParentTable
        return tuple(Parent(each.name, each.digest) for each in TableList(kind).read(value))


def key_of(of: Field[Any]) -> str:
    """Return the key that a field of a table has in a file."""
    return str(of.metadata["key"] or of.name)


def _fill(table: ConfigTable, raw: Mapping[str, object]) -> None:
    """Read a raw table and set the fields of `table`. Raises Violation with all mistakes."""
    values, mistakes = examine(type(table), raw)
    if not mistakes:
        for name, value in values.items():
            object.__setattr__(table, name, value)
        mistakes = list(table.contradictions())
    if mistakes:
        raise Violation(mistakes)


@cache
def _names(between: Between) -> tuple[str, ...]:
    return tuple(inspect.signature(between).parameters)
