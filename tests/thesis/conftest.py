"""Fixture: `reproduce` uses the chapters of this checkout, not those of an installed package."""

import tomllib
from importlib import metadata
from pathlib import Path

import pytest

from needleplan.reports import chapters

PROJECT = Path(__file__).parents[2] / "pyproject.toml"


@pytest.fixture(autouse=True, scope="module")
def _chapters_of_this_checkout() -> object:
    listed = tomllib.loads(PROJECT.read_text())["project"]["entry-points"][chapters.GROUP]
    points = metadata.EntryPoints(metadata.EntryPoint(name, value, chapters.GROUP) for name, value in listed.items())
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(metadata, "entry_points", lambda **given: points.select(**given))
        yield
