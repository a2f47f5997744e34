"""The public interface: every public callable is documented in numpydoc sections and has an example."""

import enum
import importlib
import inspect
import pkgutil
import re
from collections.abc import Iterator
from typing import Any

import pytest
from numpydoc.docscrape import NumpyDocString

import needleplan as npl
from needleplan import planning
from tests.pages import ROOT

# Public names that are no callables: the version, and the modules.
NO_CALLABLES = {"__version__", "mdp", "models", "recording"}

# Classes that the public methods return.
ANSWERS = ("Action", "Decision", "Decisions", "Entry", "Expectations", "Outcome", "Path", "Rollouts", "Stats", "Status")


def public() -> Iterator[tuple[str, Any]]:
    """Yield the name and the object of every public class, function and method.

    The names of `models` and `recording` are public; of their classes, what a user reads is the class itself.
    """
    whole = {name: getattr(npl, name) for name in npl.__all__ if name not in NO_CALLABLES}
    whole |= {f"mdp.{name}": getattr(npl.mdp, name) for name in npl.mdp.__all__}
    whole |= {name: getattr(planning, name) for name in ANSWERS} | {"recording.Recording": npl.recording.Recording}
    for name, each in whole.items():
        yield name, each
        if inspect.isclass(each) and not issubclass(each, Exception):
            for method in dir(each):
                function = getattr(getattr(each, method), "__func__", getattr(each, method))
                room = function.__module__.split(".")[:2] if inspect.isfunction(function) else []
                if room[:1] == ["needleplan"] and room != ["needleplan", "config"] and not method.startswith("_"):
                    yield f"{name}.{method}", function
    for module in (npl.models, npl.recording):
        for name in module.__all__:
            if inspect.isclass(getattr(module, name)) or inspect.isfunction(getattr(module, name)):
                yield f"{module.__name__.removeprefix('needleplan.')}.{name}", getattr(module, name)


PUBLIC = dict(public())


def parameters(each: Any) -> list[str]:
    """Return the names of the parameters of a callable, without `self` and `cls`."""
    try:
        names = list(inspect.signature(each).parameters)
    except ValueError:
        return []
    return [name for name in names if name not in ("self", "cls")]


@pytest.mark.parametrize("name", PUBLIC)
def test_sections(name: str) -> None:
    each = PUBLIC[name]
    text = inspect.getdoc(each)
    assert text, "has no docstring"
    sections = NumpyDocString(text)  # raises a warning, hence an error, for sections it does not know
    assert text.splitlines()[0].endswith((".", ";")), "the first line is not a sentence"
    entries = [*sections["Parameters"], *sections["Attributes"]]
    documented = [part.strip(" *") for entry in entries for part in entry.name.split(",")]
    wanted = parameters(each) if not is_enumeration(each) else []
    if inspect.isclass(each):
        assert set(wanted) <= set(documented), "a parameter is not documented"
    if inspect.isfunction(each):
        assert documented == wanted, "documents parameters that do not exist"
        returned = inspect.signature(each).return_annotation
        assert bool(sections["Returns"]) == (returned not in (None, "None")), "Returns"
    owner = inspect.getdoc(PUBLIC[name.rpartition(".")[0]]) if name.rpartition(".")[0] in PUBLIC else ""
    shown = any(">>> " in line for line in sections["Examples"]) or f".{name.rpartition('.')[2]}(" in str(owner)
    assert shown, "neither it nor its class has an example"


def is_enumeration(each: Any) -> bool:
    """Return whether `each` is an enumeration."""
    return hasattr(each, "__members__")


def enumerations() -> Iterator[type[enum.Enum]]:
    """Yield every enumeration that a module with a public name offers.

    Those of `devices` are left out: their numbers are those of protocols.
    """
    names = [name for _, name, _ in pkgutil.walk_packages(npl.__path__, "needleplan.")]
    for name in ("needleplan", *names):
        if ".devices" in name or any(part.startswith("_") for part in name.split(".")):
            continue
        module = importlib.import_module(name)
        for each in (getattr(module, offered) for offered in getattr(module, "__all__", [])):
            if is_enumeration(each):
                yield each


def test_every_member_of_a_public_enumeration_equals_its_text() -> None:
    found = set(enumerations())
    assert {npl.Action, npl.Outcome, npl.Status, npl.Edge, planning.SuccessSource} <= found
    assert [member for each in found for member in each if member != str(member) or {str(member): 0}[member]] == []


def test_the_page_names_every_public_name() -> None:
    text = (ROOT / "docs/reference/python.md").read_text(encoding="utf-8")
    for name in npl.__all__:
        assert f"npl.{name}" in text, name
    for method in [name for name in PUBLIC if name.startswith(("PolicyTable.", "Pose."))]:
        assert re.search(rf"\b{method.split('.')[1]}\(", text), method


def test_what_the_page_names_is_there() -> None:
    text = (ROOT / "docs/reference/python.md").read_text(encoding="utf-8")
    names = set(re.findall(r"`npl\.([\w.]+)", text))
    assert len(names) > 10
    assert [name for name in names if not exists(name)] == []


def exists(name: str) -> bool:
    """Return whether `npl` has a name, which may be of several parts."""
    value: Any = npl
    for part in name.split("."):
        value = getattr(value, part, None)
    return value is not None
