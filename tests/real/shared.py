"""Measurements that other people made; without a licence to ship them, they stand beside the repository."""

from pathlib import Path

import pytest

DATA = Path(__file__).resolve().parents[3] / "shared" / "data"


def require(*names: str) -> Path:
    """Return the folder of some data, or skip the test, or the module."""
    folder = DATA.joinpath(*names)
    if not folder.exists():
        pytest.skip(f"measurements of others are not here: {folder}", allow_module_level=True)
    return folder
