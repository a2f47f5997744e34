"""TOML files: reading the text of a file, parsing it to a table, and writing TOML."""

from __future__ import annotations

import json
import os
import re
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import Any, TypeVar

from needleplan.artifacts import other_kind, path_text, present_format, version_advice
from needleplan.config._rules import Violation, shown, suggestion
from needleplan.config._table import ConfigTable, ParentList, TableList, build, key_of
from needleplan.errors import InputError, Mistake

__all__ = ["Commented", "parse_toml", "raw_of", "raw_toml", "read_toml", "shipped_names", "text_of", "toml_text"]

_T = TypeVar("_T", bound=ConfigTable)
_BARE = re.compile(r"[A-Za-z0-9_-]+")


def text_of(
    path: str | os.PathLike[str], error: type[InputError], shipped: Path | None = None, noun: str = "file"
) -> str:
    """Return the text of a file, or, if there is no such file, of the shipped file with this name.

    Parameters
    ----------
    path : str or path
        Path of a file, or name of a shipped file without `.toml`.
    error : type
        Class of the error that is raised.
    shipped : pathlib.Path, optional
        Folder of the shipped TOML files. None: there are no shipped files.
    noun : str, default "file"
        Kind of the file in messages.

    Returns
    -------
    str

    Raises
    ------
    InputError
        Neither file exists, or the file cannot be read or is not UTF-8. The class is `error`.
    """
    source, names = path_text(path, error), shipped_names(shipped)
    try:
        if shipped and source in names and not Path(path).is_file():  # a folder of that name is none
            return (shipped / f"{source}.toml").read_text(encoding="utf-8")
        return Path(path).read_text(encoding="utf-8")
    except UnicodeDecodeError as wrong:
        rule = f"is not TOML: not UTF-8 at byte {wrong.start}"
    except (OSError, ValueError) as wrong:
        rule = f"cannot be read: {getattr(wrong, 'strerror', None) or wrong}"
        if shipped and isinstance(wrong, FileNotFoundError):
            known = f"({', '.join(names)}){suggestion(source, names)}"
            rule = f"no such file, and no shipped {noun} of that name {known}"
    raise error(rule, source)


def shipped_names(folder: Path | None) -> list[str]:
    """Return the sorted names, without `.toml`, of the TOML files in `folder`; an empty list if `folder` is None."""
    return sorted(file.stem for file in folder.glob("*.toml")) if folder else []


def read_toml(path: str | os.PathLike[str], kind: type[_T]) -> _T:
    """Return the table in a TOML file.

    Parameters
    ----------
    path : str or path
        Path of the file.
    kind : type
        Class of the table. Its `error` is the class of the error below.

    Returns
    -------
    ConfigTable
        Instance of `kind`.

    Raises
    ------
    InputError
        The file cannot be read, or has mistakes. The error lists all of them.
    """
    return parse_toml(text_of(path, kind.error), kind, os.fspath(path))


def parse_toml(text: str, kind: type[_T], source: str = "") -> _T:
    """Return the table in a TOML text.

    Parameters
    ----------
    text : str
        TOML text.
    kind : type
        Class of the table. Its `error` is the class of the error below.
    source : str, optional
        Name of the text in messages.

    Returns
    -------
    ConfigTable
        Instance of `kind`.

    Raises
    ------
    InputError
        The text is not TOML, or has mistakes, such as a wrong schema. The error lists all of them.
    """
    raw = raw_toml(text, kind.error, source)
    mistakes: list[Mistake] = []
    found = present_format(str(raw.get("schema", "")))
    if kind.schema and found != kind.schema:
        value = shown(raw["schema"]) if "schema" in raw else ""
        if other := other_kind(found, kind.schema):  # none of its keys belongs here
            rule = f'must be "{kind.schema}"; the kind of this file is {other}'
            raise kind.error(Mistake("schema", value, rule), source)
        advice = version_advice(found, kind.schema)
        mistakes.append(Mistake("schema", value, f'must be "{kind.schema}"' + (f"; {advice}" if advice else "")))
    if kind.schema:
        raw.pop("schema", None)
    try:
        made = build(kind, raw)
    except Violation as broken:
        mistakes += broken.mistakes
    if mistakes:
        raise kind.error(mistakes, source)
    return made


def raw_toml(text: str, error: type[InputError], source: str = "") -> dict[str, Any]:
    """Parse a TOML text without checking its values.

    Parameters
    ----------
    text : str
        TOML text.
    error : type
        Class of the error that is raised.
    source : str, optional
        Name of the text in messages.

    Returns
    -------
    dict

    Raises
    ------
    InputError
        The text is not TOML. The class is `error`.
    """
    if not isinstance(text, str):
        raise error(Mistake("text", f"<{type(text).__name__}>", "must be the text of a TOML file"), source)
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as wrong:
        raise error(f"is not TOML: {wrong}", source) from None


@dataclass(frozen=True)
class Commented:
    """A value or a table, and a comment that is written at the end of the line of the value or header."""

    value: Any
    comment: str


def raw_of(table: object, *, commented: bool = False) -> dict[str, Any]:
    """Return the contents of a table by key, as a TOML file stores them, the schema first.

    Fields that are None, empty tables, or empty lists of tables are left out.

    Parameters
    ----------
    table : object
        Instance of a `ConfigTable` or another dataclass.
    commented : bool, default False
        Whether to wrap values whose field has a text `about` in `Commented` with this text.

    Returns
    -------
    dict
    """
    raw: dict[str, Any] = {}
    if isinstance(table, ConfigTable) and table.schema:
        raw["schema"] = table.schema
    for field in fields(table):  # type: ignore[arg-type]
        value = getattr(table, field.name)
        is_list = isinstance(field.metadata.get("rule"), TableList | ParentList)
        if value is None or value == {} or (value == () and is_list):
            continue
        about = field.metadata.get("about") if commented else ""
        value = _raw(value, commented)
        raw[key_of(field) if field.metadata else field.name] = Commented(value, about) if about else value
    return raw


def toml_text(document: Mapping[str, Any], header: str = "") -> str:
    """Return the text of a TOML file that reads back as a document.

    Within a table, values are written before tables; otherwise the order is kept. A blank line precedes every header,
    except a single `[table]` within a list of tables.

    Parameters
    ----------
    document : mapping
        Values by key.
    header : str, optional
        Lines that come first, as comments.

    Returns
    -------
    str

    Raises
    ------
    TypeError
        TOML cannot represent a value.
    """
    head = [f"# {line}".rstrip() for line in header.splitlines()]
    return "\n".join([*head, *_lines(document, "", False)]) + "\n"


def _lines(table: Mapping[str, Any], path: str, listed: bool) -> Iterator[str]:
    values = {key: value for key, value in table.items() if not _is_table(value)}
    for key, value in values.items():
        yield f"{_name(key)} = {_value(value)}{_comment(value)}"
    for key, value in table.items():
        if key in values:
            continue
        name, inner = f"{path}{_name(key)}", _bare(value)
        if isinstance(inner, Mapping):
            if not inner or not all(map(_is_table, inner.values())):
                yield from ([] if listed else [""])
                yield f"[{name}]{_comment(value)}"
            yield from _lines(inner, f"{name}.", listed)
        else:
            for each in inner:
                yield from ("", f"[[{name}]]{_comment(each) or _comment(value)}")
                yield from _lines(_bare(each), f"{name}.", True)


def _value(value: object) -> str:
    value = _bare(value)
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        # JSON strings are valid TOML strings, except for the character 0x7f.
        return json.dumps(str(value), ensure_ascii=False).replace("\x7f", "\\u007F")
    if isinstance(value, int | float):
        return repr(value)
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_value, value))}]"
    if isinstance(value, Mapping):
        inner = ", ".join(f"{_name(key)} = {_value(each)}" for key, each in value.items())
        return f"{{ {inner} }}" if inner else "{}"
    raise TypeError(f"TOML cannot hold a {type(value).__name__}")


def _raw(value: object, commented: bool) -> object:
    if is_dataclass(value):
        return raw_of(value, commented=commented)
    if isinstance(value, tuple) and any(map(is_dataclass, value)):
        return [raw_of(each, commented=commented) for each in value]
    return value


def _is_table(value: object) -> bool:
    value = _bare(value)
    entries = (
        isinstance(value, list | tuple) and bool(value) and all(isinstance(_bare(each), Mapping) for each in value)
    )
    return isinstance(value, Mapping) or entries


def _bare(value: Any) -> Any:
    return value.value if isinstance(value, Commented) else value


def _comment(value: object) -> str:
    return f"  # {value.comment}" if isinstance(value, Commented) and value.comment else ""


def _name(key: str) -> str:
    return key if _BARE.fullmatch(key) else _value(key)
