"""Messages are one line a mistake."""

import inspect

import pytest

from needleplan import errors
from needleplan.errors import InputError, Mistake


def test_one_mistake_is_one_line() -> None:
    assert str(InputError(Mistake("a.b", "3", "must be 4"), "file.toml")) == "file.toml: a.b = 3: must be 4"
    assert str(InputError(Mistake("a.b", "", "is missing"))) == "a.b: is missing"
    assert str(InputError("is no table", "t.h5")) == "t.h5: is no table"


def test_many_mistakes_are_a_list() -> None:
    error = InputError([Mistake("a", "1", "must be 2"), Mistake("b", "x" * 100, "must be short")], "f")
    assert str(error).splitlines() == ["f: 2 mistakes", "  a = 1: must be 2", f"  b = {'x' * 59}…: must be short"]


def test_the_tree_in_the_docstring_is_the_tree() -> None:
    drawn = errors.__doc__ or ""
    for name, kind in inspect.getmembers(errors, inspect.isclass):
        if issubclass(kind, Exception):
            assert f"{name} " in drawn or f"{name}\n" in drawn
            assert issubclass(kind, errors.NeedleplanError)
    with pytest.raises(errors.TableError):
        raise errors.ChecksumError("altered")
