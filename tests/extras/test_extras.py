"""Planning and the look-up need few libraries; what misses another library says how to install it."""

import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from needleplan.errors import InputError, MissingLibraryError
from needleplan.extras import EXTRAS, explained, require
from tests.conftest import SMALL

PROJECT = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())["project"]
# Names on the package index of libraries that Python imports under another name.
DISTRIBUTIONS = {"nrrd": "pynrrd"}
# Extras for those who change needleplan.
DEVELOPERS = {"docs", "test"}

# Makes all libraries of extras missing, as they are where needleplan is installed without extras.
WITHOUT = """
import sys
from needleplan.extras import EXTRAS
class Missing:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in EXTRAS:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
sys.meta_path.insert(0, Missing())
"""
PLAN = """
import needleplan as npl
from pathlib import Path
Path("small.toml").write_text({small!r})
table = npl.plan("small.toml")
entry = table.best_entry(edge="left")
table.lookup(40.0, 36.0, 0.1, -1), table.path(entry), table.rollout(entry, runs=100, seed=0)
table.write("table.h5")
assert npl.PolicyTable.read("table.h5", isolated=True).digest == table.digest
assert "<p>" in table._repr_html_()
"""
COMMANDS = """
from needleplan.cli import main
for words in {commands!r}:
    assert main(words) == 0, words
"""
PLANNING = [
    ["plan", "small.toml", "-o", "table.h5", "--force"],
    ["info", "table.h5"],
    ["path", "table.h5", "--start", "0,20,0"],
    ["evaluate", "table.h5", "--start", "0,20,0", "--runs", "100"],
    ["entry", "table.h5"],
    ["scenarios"],
    ["new", "mine", "-o", "mine.toml"],
    ["view", "table.h5", "--export", "plan.html"],
    ["completion", "bash"],
]
REFUSED = [
    ("figures", ["plan", "four_obstacles", "--figure", "plan.png"]),
    ("lab", ["identify", "friction", "data.csv"]),
    ("lab", ["insert", "table.h5"]),
    ("lab", ["lab"]),
    ("lab", ["diagnose", "model.toml", "data.csv", "-o", "found"]),
    ("lab", ["recording", "info", "run.mcap"]),
    ("lab", ["simulate", "friction", "-o", "run.mcap"]),
    ("lab", ["reproduce", "ch6"]),
    ("view", ["view", "four_obstacles", "--no-browser"]),
    ("volumes", ["new", "mine", "--anatomy", "liver"]),
]


def python(program: str, folder: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", program], cwd=folder, capture_output=True, text=True, timeout=120, check=False
    )


def test_importing_needleplan_imports_neither_numpy_nor_any_optional_library(tmp_path: Path) -> None:
    heavy = sorted({*EXTRAS, "numpy", "h5py", "shapely", "rich", "serial", "pandas", "typing", "asyncio"})
    program = (
        f"import sys; before = set(sys.modules); import needleplan; print({{*{heavy}}} & (set(sys.modules) - before))"
    )
    assert python(program, tmp_path).stdout == "set()\n"


def test_planning_imports_numpy_and_no_optional_library(tmp_path: Path) -> None:
    imports = "import sys; from needleplan import PolicyTable, Scenario, plan"
    program = f"{imports}; print({{*{sorted(EXTRAS)}}} & {{*sys.modules}})"
    assert python(program, tmp_path).stdout == "set()\n"


@pytest.mark.slow
def test_planning_needs_no_extra(tmp_path: Path) -> None:
    done = python(WITHOUT + PLAN.format(small=SMALL) + COMMANDS.format(commands=PLANNING), tmp_path)
    assert (done.returncode, done.stderr.count("Traceback")) == (0, 0), done.stderr
    assert (tmp_path / "plan.html").stat().st_size > 100_000


def test_every_command_that_needs_an_extra_names_it(tmp_path: Path) -> None:
    codes = "[main(words) for words in " + repr([words for _, words in REFUSED]) + "]"
    done = python(f"{WITHOUT}\nfrom needleplan.cli import main\nprint({codes})", tmp_path)
    assert done.stdout == f"{[2] * len(REFUSED)}\n", done.stderr
    named = re.findall(
        r"^needleplan: .*needs? .*: install (?:it|them) with `pip install needleplan\[(\w+)\]`$", done.stderr, re.M
    )
    assert named == [extra for extra, _ in REFUSED], done.stderr


@pytest.mark.parametrize("package", ["models", "recording", "identification", "estimation", "control", "diagnosis"])
def test_every_package_of_the_lab_names_the_extra(package: str, tmp_path: Path) -> None:
    done = python(f"{WITHOUT}\nimport needleplan.{package}", tmp_path)
    assert done.stderr.endswith("MissingLibraryError: needs scipy: install it with `pip install needleplan[lab]`\n")


def test_extras_are_those_of_the_package() -> None:
    for library, extra in EXTRAS.items():
        assert any(
            re.match(rf"{DISTRIBUTIONS.get(library, library)}\b", each)
            for each in PROJECT["optional-dependencies"][extra]
        ), library
    (everything,) = PROJECT["optional-dependencies"]["all"]
    users = {*PROJECT["optional-dependencies"]} - {"all"} - DEVELOPERS
    assert set(re.findall(r"\w+", everything.partition("[")[2])) == users


def test_a_missing_library_is_an_import_error_too() -> None:
    error = ModuleNotFoundError("No module named 'nowhere'", name="nowhere")
    assert explained(error) is None
    assert explained(ModuleNotFoundError(name="numpy.nowhere")) is None
    require("numpy")
    assert issubclass(MissingLibraryError, ImportError)
    assert issubclass(MissingLibraryError, InputError)
