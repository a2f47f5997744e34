"""Prepares docstrings for reStructuredText: they are written to be read as they stand, with tables as in Markdown."""

import re
from functools import partial
from typing import Any

from jinja2 import BytecodeCache
from jinja2.bccache import Bucket
from jinja2.sandbox import SandboxedEnvironment
from numpydoc import docscrape_sphinx

_CODE = re.compile(r"(``.*?``|`[^`]*`)")
_RULE = re.compile(r"\s*\|[\s:|-]+\|\s*")


class KeptTemplates(BytecodeCache):
    """Compiled templates in memory: numpydoc makes a new environment, which knows none, for every docstring."""

    def __init__(self) -> None:
        self._compiled: dict[str, bytes] = {}

    def load_bytecode(self, bucket: Bucket) -> None:
        """Fill in the code of a template, if it is known."""
        if bucket.key in self._compiled:
            bucket.bytecode_from_string(self._compiled[bucket.key])

    def dump_bytecode(self, bucket: Bucket) -> None:
        """Keep the code of a template."""
        self._compiled[bucket.key] = bucket.bytecode_to_string()


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
    # A quarter of the time of a build without scenes went into compiling one template again and again.
    docscrape_sphinx.SandboxedEnvironment = partial(SandboxedEnvironment, bytecode_cache=KeptTemplates())
    app.connect("autodoc-process-docstring", prepare, priority=900)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
