"""The exports of the rooms: every callable with two or more arguments names its parameters, result and errors."""

import importlib
import inspect
import pkgutil
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from numpydoc.docscrape import NumpyDocString

import needleplan

# Rooms without exports for other programs: command lines, nodes, and files that are copied.
NO_ROOMS = {"__main__", "cli", "examples", "ros2"}

ROOMS = sorted(
    module.name
    for module in pkgutil.iter_modules(needleplan.__path__)
    if not module.name.startswith("_") and module.name not in NO_ROOMS
)


def arguments(function: Callable[..., Any]) -> list[str]:
    """Return the names of the parameters of a function, without `self` and `cls`."""
    return [name for name in inspect.signature(function).parameters if name not in ("self", "cls")]


def methods(kind: type) -> Iterator[Callable[..., Any]]:
    """Yield the public methods that a class defines and none of its bases does."""
    for name, member in vars(kind).items():
        function = member.__func__ if isinstance(member, classmethod | staticmethod) else member
        inherited = any(name in vars(base) for base in kind.__mro__[1:])
        if inspect.isfunction(function) and not name.startswith("_") and not inherited:
            yield function


def exported(room: str) -> dict[str, Callable[..., Any]]:
    """Return the functions and methods with two or more arguments that a room exports, by their full names."""
    module = importlib.import_module(f"needleplan.{room}")
    functions: list[Callable[..., Any]] = []
    for name in getattr(module, "__all__", []):
        value = getattr(module, name)
        if not getattr(value, "__module__", "").startswith("needleplan"):
            continue
        if inspect.isclass(value):
            functions += methods(value)
        elif inspect.isfunction(inspect.unwrap(value)):
            functions.append(value)
    return {f"{each.__module__}.{each.__qualname__}": each for each in functions if len(arguments(each)) > 1}


def missing(function: Callable[..., Any]) -> list[str]:
    """Return what the docstring of a function lacks: `Parameters`, `Returns`, or names of parameters."""
    sections = NumpyDocString(inspect.getdoc(function) or "")
    lacking = [] if sections["Parameters"] else ["Parameters"]
    documented = [part.strip(" *") for entry in sections["Parameters"] for part in entry.name.split(",")]
    wanted = arguments(function)
    lacking += [name for name in wanted if name not in documented]
    lacking += [f"{name}, which is no parameter" for name in documented if name not in wanted]
    if inspect.signature(function).return_annotation not in (None, "None") and not (
        sections["Returns"] or sections["Yields"]
    ):
        lacking.append("Returns")
    return lacking


@pytest.mark.parametrize("room", ROOMS)
def test_exported_callables_name_their_parameters(room: str) -> None:
    lacking = {name: missing(function) for name, function in exported(room).items()}
    assert {name: words for name, words in lacking.items() if words} == {}


def test_missing_names_what_a_docstring_lacks() -> None:
    def scaled(length_mm: float, factor: float) -> float:  # noqa: D417
        """Return a length times a factor.

        Parameters
        ----------
        length_mm
            Length (mm).
        scale
            Factor.
        """
        return length_mm * factor

    assert missing(scaled) == ["factor", "scale, which is no parameter", "Returns"]
