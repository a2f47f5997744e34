"""Every exported dataclass has a repr in one line, below 200 characters, with long values in all of its fields.

Those that a class writes itself are shown by real objects, in `test_reprs`.
"""

import enum
import importlib
import inspect
import pkgutil
import sys
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

import needleplan as npl
from needleplan.artifacts import MOST_CHARACTERS, CallRepr, short_repr

# Classes nested in each other beyond which a field is None, so that a class may hold itself.
DEEPEST = 4
ARRAYS, MAPPINGS, SEQUENCES = ("NDArray", "Array"), ("dict", "Mapping"), ("tuple", "list", "Sequence", "frozenset")
PLAIN = {
    "float": 0.1234567890123456,
    "int": 123456,
    "bool": True,
    "str": "a text of forty characters, and no more.",
    "bytes": b"b" * 100,
    "Path": Path("/home/someone/data/measurements.csv"),
}


def is_general(kind: Any) -> bool:
    """Return whether a class is a dataclass, not abstract, with a repr that it does not write itself."""
    if not is_dataclass(kind) or inspect.isabstract(kind):
        return False
    # Python wraps the repr that it makes for a dataclass.
    return kind.__repr__ in (CallRepr.__repr__, short_repr) or hasattr(kind.__repr__, "__wrapped__")


def exported() -> dict[str, type]:
    """Return the general classes that modules with a public name export, by their names."""
    found = {}
    for name in ("needleplan", *(each for _, each, _ in pkgutil.walk_packages(npl.__path__, "needleplan."))):
        if any(part.startswith("_") for part in name.split(".")):
            continue
        module = importlib.import_module(name)
        offered = (getattr(module, each) for each in getattr(module, "__all__", []))
        found |= {each.__name__: each for each in offered if inspect.isclass(each) and is_general(each)}
    return found


CLASSES = exported()


def filled(kind: type, depth: int = 0) -> Any:
    """Return an object of a dataclass with long values in its fields, without calling its constructor."""
    made = object.__new__(kind)
    for base in reversed(kind.__mro__):
        for name, annotation in vars(base).get("__annotations__", {}).items():
            if name in {each.name for each in fields(kind)}:
                object.__setattr__(made, name, sample(str(annotation), sys.modules[base.__module__], depth))
    return made


def sample(annotation: str, module: Any, depth: int) -> Any:
    """Return a long value for an annotation."""
    if annotation.startswith(ARRAYS):
        return np.linspace(0, 1, 50)
    if annotation.startswith(MAPPINGS):
        return {f"parameter_{number}": 1 / 3 for number in range(20)} | {"time_s": np.linspace(0, 1, 50)}
    if annotation.startswith(SEQUENCES):
        inner = annotation[annotation.find("[") + 1 :].split(",")[0].rstrip("]")
        return (sample(inner, module, depth + 1),) * (12 if "..." in annotation else annotation.count(",") + 1)
    name = annotation.split("|")[0].strip()
    kind = getattr(module, name, CLASSES.get(name))
    if name in PLAIN or not inspect.isclass(kind):
        return PLAIN.get(name)
    if issubclass(kind, enum.Enum):
        return next(iter(kind))
    return filled(kind, depth + 1) if is_general(kind) and depth < DEEPEST else None


def test_no_exported_dataclass_has_a_long_repr() -> None:
    texts = {name: repr(filled(kind)) for name, kind in CLASSES.items()}
    assert len(texts) > 200
    assert {name: len(text) for name, text in texts.items() if len(text) >= MOST_CHARACTERS or "\n" in text} == {}


def test_notebooks_show_every_public_dataclass_and_tuple_as_a_table() -> None:
    rooms = (npl, npl.mdp, npl.models, npl.recording)
    kinds = [value for room in rooms for name in room.__all__ if inspect.isclass(value := getattr(room, name))]
    shown = [kind for kind in kinds if is_dataclass(kind) or issubclass(kind, tuple)]
    assert len(shown) > 40
    # The layouts of messages in a recording are no results.
    layouts = ("Field", "Json", "Packed")
    assert [k.__name__ for k in shown if not hasattr(k, "_repr_html_") and k.__name__ not in layouts] == []
