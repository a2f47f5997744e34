"""The rules of the house that a machine can check."""

import ast
import functools
import importlib
import pkgutil
import re
from collections import defaultdict
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from types import ModuleType

import pytest

import needleplan
import needleplan_thesis

ROOT = Path(__file__).parent.parent
SOURCES = sorted(
    file for folder in ("python", "tests", "benches", "rust") for kind in ("*.py", "*.rs", "*.pyi")
    for file in (ROOT / folder).rglob(kind) if "target" not in file.parts
)  # fmt: skip
MODULES = [
    name for package in (needleplan, needleplan_thesis)
    for _, name, _ in pkgutil.walk_packages(package.__path__, f"{package.__name__}.")
    if not name.endswith(("_ppvi", "__main__"))
]  # fmt: skip


class ImportGraph:
    """Which file takes a name from which other file; a name that a package hands on counts for the file it is from."""

    def __init__(self, root: Path) -> None:
        self.trees = {self._name(file, root): ast.parse(file.read_text()) for file in sorted(root.rglob("*.py"))}
        self.handed_on = {
            module: {
                alias.asname or alias.name: (node.module, alias.name)
                for node in tree.body if isinstance(node, ast.ImportFrom) and node.module in self.trees
                for alias in node.names
            }
            for module, tree in self.trees.items()
        }  # fmt: skip

    @staticmethod
    def _name(file: Path, root: Path) -> str:
        return ".".join(file.relative_to(root).with_suffix("").parts).removesuffix(".__init__")

    def home(self, module: str, name: str) -> str:
        """Return the module in which `name` of `module` is defined."""
        if f"{module}.{name}" in self.trees:
            return f"{module}.{name}"
        further = self.handed_on[module].get(name)
        return self.home(*further) if further else module

    def edges(self) -> dict[str, set[str]]:
        found: dict[str, set[str]] = {}
        for module, tree in self.trees.items():
            nodes = [node for node in ast.walk(tree) if isinstance(node, ast.Import | ast.ImportFrom)]
            named = [
                (str(node.module), alias.name)
                for node in nodes if isinstance(node, ast.ImportFrom)
                for alias in node.names if alias.name != "_ppvi"
            ]  # fmt: skip
            plain = [alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names]
            homes = {self.home(source, name) for source, name in named if source in self.trees}
            found[module] = (homes | {each for each in plain if each in self.trees}) - {module}
        return found


@functools.cache
def graph(folder: str) -> ImportGraph:
    return ImportGraph(ROOT / folder)


@pytest.mark.parametrize("folder", ["python", "benches/python"])
def test_no_file_imports_itself_by_way_of_others(folder: str) -> None:
    try:
        TopologicalSorter(graph(folder).edges()).prepare()
    except CycleError as error:
        pytest.fail(f"an import cycle: {' -> '.join(error.args[1])}")


def test_class_names_are_unique() -> None:
    homes = defaultdict(list)
    for module, tree in graph("python").trees.items():
        for node in tree.body:
            if isinstance(node, ast.ClassDef):
                homes[node.name].append(module)
    assert not {name: modules for name, modules in homes.items() if len(modules) > 1}


def unclear(method: ast.FunctionDef) -> set[str]:
    """Return the public attributes of `self` that a method sets without an annotation, a literal or a parameter."""
    parameters = {each.arg for each in [*method.args.args, *method.args.kwonlyargs]}
    annotated, others = set(), set()
    for node in ast.walk(method):
        if isinstance(node, ast.AnnAssign):
            annotated.add(ast.unparse(node.target))
        if isinstance(node, ast.Assign) and not isinstance(node.value, ast.Constant):
            for target in node.targets:
                if isinstance(target, ast.Tuple) or ast.unparse(node.value) not in parameters:
                    others |= {ast.unparse(each) for each in getattr(target, "elts", [target])}
    return {name.removeprefix("self.") for name in others - annotated if re.fullmatch(r"self\.[^\W_]\w*", name)}


def test_attributes_have_annotations() -> None:
    """Type checkers infer an attribute without annotation differently, unless it is a literal or a parameter."""
    trees = graph("python").trees.values()
    classes = {node.name: node for tree in trees for node in tree.body if isinstance(node, ast.ClassDef)}

    def declared(node: ast.ClassDef) -> set[str]:
        bases = [classes[name] for base in node.bases if (name := ast.unparse(base).partition("[")[0]) in classes]
        own = {ast.unparse(each.target) for each in node.body if isinstance(each, ast.AnnAssign)}
        return own.union(*map(declared, bases))

    wrong = {
        f"{name}.{attribute}"
        for name, node in classes.items()
        for method in node.body
        if not name.startswith("_") and isinstance(method, ast.FunctionDef) and method.name == "__init__"
        for attribute in unclear(method) - declared(node)
    }
    assert not wrong


def test_no_file_is_long_or_has_a_name_that_says_nothing() -> None:
    names = {"utils", "helpers", "manager", "handler", "common", "misc"}
    wrong = [
        str(file.relative_to(ROOT))
        for file in SOURCES
        if len(file.read_text().splitlines()) > 400 or file.stem in names
    ]
    assert not wrong


def visible(module: ModuleType) -> set[str]:
    """Names that a module defines itself and does not hide."""
    own = {
        name for name, value in vars(module).items()
        if not name.startswith("_") and not isinstance(value, ModuleType)
        and f"{getattr(value, '__module__', module.__name__)}.".startswith(f"{module.__name__}.")
    }  # fmt: skip
    return own - {"annotations", "TYPE_CHECKING"}


def test_all_is_what_a_module_offers() -> None:
    wrong = []
    for name in MODULES:
        module = importlib.import_module(name)
        offered = getattr(module, "__all__", [])
        unlisted = set()
        if not hasattr(module, "__path__"):
            unlisted = {each for each in visible(module) if hasattr(getattr(module, each), "__module__")} - {*offered}
        missing = [each for each in offered if not hasattr(module, each)]
        if missing or len(offered) != len({*offered}) or (unlisted and hasattr(module, "__all__")):
            wrong.append((name, sorted(unlisted), missing))
        if not (module.__doc__ or "").strip():
            wrong.append((name, "has no docstring", []))
    assert not wrong


def test_the_package_shows_what_it_offers() -> None:
    assert dir(needleplan) == sorted(needleplan.__all__)
    assert all(getattr(needleplan, name) is not None for name in needleplan.__all__)
    with pytest.raises(AttributeError, match="no attribute 'plam'"):
        needleplan.plam  # noqa: B018
