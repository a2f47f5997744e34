"""Tables: frozen dataclasses with one rule per field, built from the tables of a file or by a constructor."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import MISSING, Field, dataclass, field, fields
from functools import cache
from typing import Any, ClassVar, TypeVar

from needleplan.artifacts import CallRepr, Parent
from needleplan.config._rules import Choice, Rule, Text, Violation, sequence, suggestion
from needleplan.errors import InputError, Mistake

__all__ = [
    "REQUIRED",
    "ConfigTable",
    "Given",
    "Keyed",
    "ParentList",
    "Subtable",
    "TableList",
    "build",
    "examine",
    "key_of",
    "mistakes_of",
    "ruled",
    "under",
]

Between = Callable[..., Iterable[Mistake]]
_T = TypeVar("_T", bound="ConfigTable")


class _Required:
    """Type of `REQUIRED`."""

    def __repr__(self) -> str:
        return "required"


REQUIRED = _Required()
"""Default of a required field that comes after an optional one. Where it is left out, its table is a mistake."""


def ruled(
    rule: Rule | Given, default: object = MISSING, *, factory: Any = MISSING, key: str = "", about: str = ""
) -> Any:
    """Declare a field of a `ConfigTable` that is read by a rule.

    The field is optional if it has a default. Otherwise a missing `Subtable` or `Keyed` is read as an empty table, and
    any other missing field is a mistake.

    Parameters
    ----------
    rule : Rule or Given
        Rule that reads the value.
    default : object, optional
        Default value. `REQUIRED` means none.
    factory : object, optional
        Function that returns the default value.
    key : str, optional
        Key in a file, if it differs from the name of the field.
    about : str, optional
        Comment on the field in commented files.

    Returns
    -------
    dataclasses.Field
    """
    metadata = {"rule": rule, "key": key, "about": about}
    if factory is not MISSING:
        return field(default_factory=factory, metadata=metadata)
    return field(default=default, metadata=metadata)


@dataclass(frozen=True)
class Given:
    """Makes the rule of a field depend on the value of an earlier field, such as the parameters on the `kind`.

    `field` is the name of the earlier field; `rule` returns the rule for its value. If the earlier field has a mistake
    or is None, the dependent field is not read.
    """

    field: str
    rule: Callable[[Any], Rule]


@dataclass(frozen=True)
class ConfigTable(CallRepr):
    """Base class of TOML tables as frozen dataclasses.

    Every field is declared by `ruled`. The constructor and the reading of a file check the same rules; the constructor
    raises `error` with all mistakes. Class arguments:

    - `key`: name of the table in messages and headers, such as `needle.layer`
    - `error`: exception class that reports the mistakes
    - `schema`: value of the key `schema`, if the table is the top level of a file
    - `between`: functions that check fields against each other. The parameters of each function are named like the
      fields that the function receives, for example `(workspace, target)`; it returns the mistakes that it finds. A
      function is not called if one of its fields could not be read; in a list of tables, a wrong table is None.
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
            given = {key_of(each): getattr(self, each.name) for each in fields(self)}
            _fill(self, {key: value for key, value in given.items() if value is not REQUIRED})
        except Violation as broken:
            raise self.error(list(under(self.key, broken.mistakes))) from None

    def contradictions(self) -> Iterable[Mistake]:
        """Return the mistakes of the table as a whole, with keys relative to the table. Subclasses may override this.

        Called after the fields are set, if no field and no function in `between` has found a mistake.
        """
        return ()


def examine(kind: type[ConfigTable], raw: Mapping[str, object]) -> tuple[dict[str, Any], list[Mistake]]:
    """Return the values of the fields by name, defaults included, and all mistakes of a raw table.

    `raw` maps the keys of a file to raw values. Keys of mistakes are relative to the table. A field with a mistake has
    no value, except a list of tables: there, each wrong table is None.
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
        elif each.default is not MISSING and each.default is not REQUIRED:
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
    """Return the instance of a table class for a raw table.

    Parameters
    ----------
    kind : type
        Class of the table, a `ConfigTable`.
    raw : mapping
        Values by key, as `tomllib` returns them.

    Returns
    -------
    ConfigTable
        Instance of `kind`.

    Raises
    ------
    Violation
        The table has mistakes. The error lists all of them, with keys relative to the table.
    """
    made = object.__new__(kind)  # __post_init__ would check all rules a second time
    _fill(made, raw)
    return made


def mistakes_of(owner: object, rules: Mapping[str, Rule]) -> list[Mistake]:
    """Return the mistakes of single attributes of an object.

    Parameters
    ----------
    owner : object
        Object, such as the options of a command.
    rules : mapping
        Rules by the name of the attribute, or of the option such as `--entry-depth`. An option that was not given
        (None) has no mistake.

    Returns
    -------
    list of Mistake
    """
    mistakes: list[Mistake] = []
    for name, rule in rules.items():
        value = getattr(owner, name.removeprefix("--").replace("-", "_"))
        if value is None and name.startswith("--"):
            continue
        try:
            rule.read(value)
        except Violation as broken:
            mistakes += under(name, broken.mistakes)
    return mistakes


def under(key: str, mistakes: Iterable[Mistake]) -> Iterator[Mistake]:
    """Put a key in front of the keys of mistakes.

    For `key` "a", the key "b" becomes "a.b". A key that begins with a space is joined without a dot: " 1.b" becomes "a
    1.b".

    Parameters
    ----------
    key : str
        Key in front.
    mistakes : iterable of Mistake
        Mistakes with keys relative to `key`.

    Yields
    ------
    Mistake
    """
    for mistake in mistakes:
        dot = "." if key and mistake.key and not mistake.key.startswith(" ") else ""
        yield Mistake(f"{key}{dot}{mistake.key}", mistake.value, mistake.rule)


@dataclass(frozen=True)
class Subtable:
    """Rule for a table within a table. A missing table without a default is read as an empty table."""

    kind: type[ConfigTable]

    def read(self, value: object) -> Any:
        """Return the table as an instance of `kind`. Raises Violation."""
        if isinstance(value, self.kind):
            return value
        if not isinstance(value, Mapping):
            raise Violation(f"must be a table, [{self.kind.key}]", value)
        return build(self.kind, value)


@dataclass(frozen=True)
class TableList:
    """Rule for a list of tables with the header `[[key]]`. `at_most` limits their number; None means no limit.

    Keys of mistakes contain the number of the table, from 1, and the name if the table has one.
    """

    kind: type[ConfigTable]
    at_most: int | None = None

    def read(self, value: object) -> tuple[Any, ...]:
        """Return the tables as a tuple.

        Raises Violation. If single tables are wrong, its `partial` is the tuple with None for each wrong table.
        """
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
                title = f' ("{name}")' if isinstance(name, str) and name and name.isprintable() else ""
                mistakes += under(f" {number}{title}", broken.mistakes)
                found.append(None)
        if mistakes:
            raise Violation(mistakes, partial=tuple(found))
        return tuple(found)

    def __str__(self) -> str:
        return f"at least one [[{self.kind.key}]]"


@dataclass(frozen=True)
class Keyed(CallRepr):
    """Rule for a table whose keys and rules are known only at run time; the table is stored as a dict.

    `rules` maps keys to the rules that read their values. `others` is the rule for all other keys; if None, other keys
    are mistakes.
    """

    rules: Mapping[str, Rule]
    required: Mapping[str, str] = field(default_factory=dict)
    """Maps each key that must be present to an explanation for messages, which may be empty."""

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
    file: str = ruled(Text(), "")


@dataclass(frozen=True)
class ParentList:
    """Rule for the parents of an artefact: tables `[[parent]]` with the keys `name` and `digest`.

    If `partial`, each of the two keys may be missing and is then stored as an empty text, and `file` is a third one.
    """

    partial: bool = False

    def read(self, value: object) -> tuple[Parent, ...]:
        """Return the parents as a tuple. Raises Violation."""
        entries = sequence(value)
        if entries is not None and all(isinstance(entry, Parent) for entry in entries):
            return tuple(entries)  # type: ignore[arg-type]
        kind = _PartialParentTable if self.partial else _ParentTable
        tables = TableList(kind).read(value)
        return tuple(Parent(each.name, each.digest, getattr(each, "file", "")) for each in tables)


def key_of(of: Field[Any]) -> str:
    """Return the key under which a field of a table is stored in a file."""
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
