"""Configuration files: rules, all mistakes at once, suggestions for misspelt names, TOML reading and writing.

A *rule* maps a raw value, as TOML or a caller gives it, to its stored form, or to a list of mistakes (key, value, rule)
whose keys are relative to the value::

    read : Raw -> Value + [Mistake]

The rule of a table is the product of the rules of its fields. It reports the mistakes of all fields, each under the
key of its field. It also reports unknown keys, missing keys, and the mistakes of rules *between* fields, which are
checked if all their fields could be read. The rule of a list of tables is the product over its entries. `Given` makes
the rule of a field depend on the value of another field. Reading is one recursion, and no mistake hides another.

A table is a frozen dataclass (`ConfigTable`) with one rule per field (`ruled`). Its constructor checks the same rules
as a file. `parse_toml` reads a text, `toml_text` writes one; for every document d without dates,
``tomllib.loads(toml_text(d)) == d``.

The package knows nothing of scenarios, models or devices.
"""

from needleplan.config._rules import (
    Choice,
    Flag,
    Integer,
    Maybe,
    Number,
    Numbers,
    Pair,
    Rule,
    Sign,
    Text,
    Texts,
    Violation,
    closest,
    plain,
    sequence,
    shown,
    suggestion,
)
from needleplan.config._table import (
    ConfigTable,
    Given,
    Keyed,
    ParentList,
    Subtable,
    TableList,
    build,
    ruled,
    under,
)
from needleplan.config._toml import (
    Commented,
    parse_toml,
    raw_of,
    raw_toml,
    read_toml,
    shipped_names,
    text_of,
    toml_text,
)

__all__ = [
    "Choice",
    "Commented",
    "ConfigTable",
    "Flag",
    "Given",
    "Integer",
    "Keyed",
    "Maybe",
    "Number",
    "Numbers",
    "Pair",
    "ParentList",
    "Rule",
    "Sign",
    "Subtable",
    "TableList",
    "Text",
    "Texts",
    "Violation",
    "build",
    "closest",
    "parse_toml",
    "plain",
    "raw_of",
    "raw_toml",
    "read_toml",
    "ruled",
    "sequence",
    "shipped_names",
    "shown",
    "suggestion",
    "text_of",
    "toml_text",
    "under",
]
