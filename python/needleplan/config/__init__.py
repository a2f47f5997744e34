"""Configuration files: rules, all mistakes at once, suggestions for misspelt names, TOML reading and writing.

A *rule* maps a raw value, as TOML or a caller gives it, to its stored form, or to a list of mistakes (key, value, rule)
whose keys are relative to the value::

    read : Raw -> Value + [Mistake]

The rule of a table applies the rules of its fields and reports the mistakes of all fields, each under the key of its
field. It also reports unknown keys, missing keys, and the mistakes of rules *between* fields; a rule between fields is
checked if all its fields could be read. The rule of a list of tables applies the rule of the table to each entry.
`Given` makes the rule of a field depend on the value of an earlier field.

A table is a frozen dataclass (`ConfigTable`) with one rule per field (`ruled`). Its constructor checks the same rules
as a file. `parse_toml` reads a text, `toml_text` writes a text; for every document d without dates and NaN,
``tomllib.loads(toml_text(d)) == d``.

The package does not depend on scenarios, models or devices.
"""

from needleplan.config._rules import (
    SEED,
    Choice,
    Flag,
    Integer,
    Maybe,
    Number,
    NumberList,
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
    REQUIRED,
    ConfigTable,
    Given,
    Keyed,
    ParentList,
    Subtable,
    TableList,
    build,
    mistakes_of,
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
    "REQUIRED",
    "SEED",
    "Choice",
    "Commented",
    "ConfigTable",
    "Flag",
    "Given",
    "Integer",
    "Keyed",
    "Maybe",
    "Number",
    "NumberList",
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
    "mistakes_of",
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
