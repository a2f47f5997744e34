"""Writes the pages of the Python interface: one for each module, from what its `__all__` offers."""

import importlib
import inspect
from abc import ABC
from pathlib import Path
from typing import Generic

# Modules with a page, in the order of the table of contents; the first one owns the names that it offers.
MODULES = (
    "needleplan",
    "needleplan.planning",
    "needleplan.scenario",
    "needleplan.mdp",
    "needleplan.anatomy",
    "needleplan.sweep",
    "needleplan.models",
    "needleplan.identification",
    "needleplan.estimation",
    "needleplan.diagnosis",
    "needleplan.recording",
    "needleplan.signals",
    "needleplan.simulation",
    "needleplan.control",
    "needleplan.devices",
    "needleplan.errors",
)


def write(folder: Path) -> list[str]:
    """Write a page for each module into a folder and return the names of the pages."""
    folder.mkdir()
    owners: dict[int, str] = {}
    for module in MODULES:
        (folder / f"{module}.rst").write_text(page(module, owners), encoding="utf-8")
    return list(MODULES)


def page(name: str, owners: dict[int, str]) -> str:
    """Return the page of a module; `owners` holds the full name of each object that has a place already."""
    module = importlib.import_module(name)
    blocks = [f"{name}\n{'=' * len(name)}", f".. automodule:: {name}"]
    for offered in sorted(module.__all__):
        value = getattr(module, offered)
        if not (inspect.isclass(value) or inspect.isroutine(value)):
            continue
        full = f"{name}.{offered}"
        owner = owners.setdefault(id(value), full)
        if owner != full:
            blocks.append(f"``{offered}``: see :py:obj:`{owner}`.")
        elif inspect.isclass(value):
            kind = "autoexception" if issubclass(value, BaseException) else "autoclass"
            blocks.append(f".. {kind}:: {full}\n   :members:{_inherited(value)}")
        else:
            blocks.append(f".. autofunction:: {full}")
    return "\n\n".join(blocks) + "\n"


def _inherited(value: type) -> str:
    """Return the option that also documents what a class has from other classes of the package."""
    bases = [each for each in value.__mro__[1:] if each not in (object, ABC, Generic)]
    ours = all(each.__module__.startswith("needleplan") for each in bases)
    return "\n   :inherited-members:" if bases and ours else ""
