"""The rules of the house for the Rust crates: one direction between crates, no cycle between files."""

import re
import tomllib
from collections.abc import Iterator
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

RUST = Path(__file__).parent.parent / "rust"
CRATES = sorted(manifest.parent.name for manifest in RUST.glob("*/Cargo.toml"))
FORBIDDEN = {
    "ppvi": {"needle", "needleplan-guard", "pyo3", "numpy"}, "needle": {"needleplan-guard", "pyo3", "numpy"},
    "guard": {"ppvi", "needle", "pyo3", "numpy"}, "needleplan-py": set(),
}  # fmt: skip


def code(file: Path) -> str:
    """The code of a file without comments and without its tests."""
    return re.sub(r"//.*", "", file.read_text()).partition("#[cfg(test)]")[0]


def names(tree: str) -> Iterator[list[str]]:
    """The paths of a use tree: `a::{b, c::d}` holds a, a::b and a::c::d."""
    head, brace, rest = tree.partition("{")
    path = [part for part in head.strip().split("::") if part]
    yield path
    if brace:
        depth, start = 0, 0
        for at, letter in enumerate(rest):
            depth += (letter == "{") - (letter == "}")
            if depth < 0 or (letter == "," and depth == 0):
                for each in names(rest[start:at]):
                    yield path + each
                start = at + 1
            if depth < 0:
                return


def imports(crate: str) -> dict[str, set[str]]:
    """For every file of a crate, the files that it names."""
    source = RUST / crate / "src"
    files = {
        "::".join(file.relative_to(source).with_suffix("").parts).removesuffix("::mod"): file
        for file in source.rglob("*.rs")
    }
    graph: dict[str, set[str]] = {}
    for name, file in files.items():
        found = set()
        for tree in re.findall(r"\bcrate::((?:\w+::)*(?:\w+|\{[^;]*))", code(file)):
            for path in names(tree):
                parts = ["::".join(path[:end]) for end in range(len(path), 0, -1)]
                found.add(next((part for part in parts if part in files), "lib"))
        if file.name in ("lib.rs", "mod.rs"):
            for tree in re.findall(r"^pub use (\w[^;]*);", code(file), re.MULTILINE):
                inside = [] if file.name == "lib.rs" else [name]
                found |= {"::".join(inside + path) for path in names(tree)} & set(files)
        graph[name] = found - {name}
    return graph


@pytest.mark.parametrize("crate", CRATES)
def test_a_crate_depends_on_lower_ones_only(crate: str) -> None:
    manifest = tomllib.loads((RUST / crate / "Cargo.toml").read_text())
    assert not FORBIDDEN[crate] & set(manifest.get("dependencies", {}))
    assert not FORBIDDEN[crate] & set(manifest.get("dev-dependencies", {}))


@pytest.mark.parametrize("crate", CRATES)
def test_no_file_imports_itself_by_way_of_others(crate: str) -> None:
    graph = imports(crate)
    assert sum(map(len, graph.values())) > len(graph) / 2
    # Raises CycleError, which names the files.
    TopologicalSorter(graph).prepare()


def test_every_unsafe_is_argued() -> None:
    for file in RUST.glob("*/src/**/*.rs"):
        lines = file.read_text().splitlines()
        for number, line in enumerate(lines):
            if re.search(r"\bunsafe (\{|impl)", line.partition("//")[0]):
                above = lines[max(number - 6, 0) : number]
                assert any("// SAFETY:" in each for each in above), f"{file}:{number + 1}"
