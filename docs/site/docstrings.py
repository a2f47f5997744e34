"""Prepares docstrings for reStructuredText: they are written to be read as they stand, with tables as in Markdown."""

import re
from typing import Any

_CODE = re.compile(r"(``.*?``|`[^`]*`)")
_RULE = re.compile(r"\s*\|[\s:|-]+\|\s*")


def prepare(_app: Any, _what: str, _name: str, _object: Any, _options: Any, lines: list[str]) -> None:
    """Replace the lines of a docstring in place: tables, and bars of absolute values, which would be substitutions."""
    result: list[str] = []
    number = 0
    while number < len(lines):
        if number + 1 < len(lines) and lines[number].lstrip().startswith("|") and _RULE.fullmatch(lines[number + 1]):
            end = number
            while end < len(lines) and lines[end].lstrip().startswith("|"):
                end += 1
            result += _table([lines[number], *lines[number + 2 : end]])
            number = end
        else:
            result.append(_escaped(lines[number]))
            number += 1
    lines[:] = result


def _table(rows: list[str]) -> list[str]:
    indent = rows[0][: len(rows[0]) - len(rows[0].lstrip())]
    block = ["", f"{indent}.. list-table::", f"{indent}   :header-rows: 1", ""]
    for row in rows:
        for place, cell in enumerate(row.strip().strip("|").split("|")):
            block.append(f"{indent}   {'* -' if place == 0 else '  -'} {cell.strip()}")
    return [*block, ""]


def _escaped(line: str) -> str:
    if line.lstrip().startswith((">>>", "...")):
        return line
    return "".join(part if part.startswith("`") else re.sub(r"(?<!\\)\|", r"\\|", part) for part in _CODE.split(line))


def setup(app: Any) -> dict[str, bool]:
    """Have autodoc prepare every docstring, after numpydoc has made its sections."""
    app.connect("autodoc-process-docstring", prepare, priority=900)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
