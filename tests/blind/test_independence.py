"""The generator knows nothing of what it is to judge."""

import ast
import sys
from pathlib import Path

import pytest

HERE = Path(__file__).parent
FILES = sorted(HERE.glob("*.py"))
# The judges of plans in the plane and in 3D, and all that their files may import beside the standard library.
JUDGE = (
    "foreign_anatomies",
    "needle_executions",
    "obstacle_volumes",
    "volume_files",
    "voxel_chords",
    "voxel_distance",
    "voxel_tracer",
)
LIBRARIES = {"nibabel", "nrrd", "numpy"}


def imported(file: Path) -> set[str]:
    names = set()
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.Import):
            names |= {each.name for each in node.names}
        elif isinstance(node, ast.ImportFrom):
            names |= {f"{node.module}.{each.name}" for each in node.names}
    return names


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.name)
def test_nothing_that_is_judged_is_imported(file: Path) -> None:
    judged = {name for name in imported(file) if name.startswith("needleplan")}
    assert not judged
    assert "importlib" not in imported(file)


@pytest.mark.parametrize("name", JUDGE)
def test_the_judge_of_plans_stands_on_array_and_file_libraries(name: str) -> None:
    allowed = LIBRARIES | set(sys.stdlib_module_names)
    for module in imported(HERE / f"{name}.py"):
        parts = module.split(".")
        assert parts[2] in JUDGE if parts[:2] == ["tests", "blind"] else parts[0] in allowed, module
