"""The beginning of every TOML file of the package: that it is TOML, of the schema wanted, with keys that are known."""

from __future__ import annotations

import tomllib
from collections.abc import Collection
from typing import Any

from needleplan.errors import Mistake
from needleplan.scenario.rules import shown, suggestion

__all__ = ["document"]


def document(text: str, schema: str, keys: Collection[str]) -> tuple[dict[str, Any] | None, list[Mistake]]:
    """Return the tables of a text, None where it is not TOML, and the mistakes at its top: schema and unknown keys."""
    try:
        found = tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        return None, [Mistake("", "", f"is not TOML: {error}")]
    mistakes = [Mistake(key, "", f"unknown key{suggestion(key, keys)}") for key in found if key not in keys]
    if found.get("schema") != schema:
        mistakes.insert(0, Mistake("schema", shown(found.get("schema", "")), f'must be "{schema}"'))
    return found, mistakes
