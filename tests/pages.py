"""Runs the code of a Markdown page, in the order in which it stands there.

- `python` blocks run in one namespace for the page, `sh` blocks in bash, which stops at the first failure; both in one
  folder that is empty at first. `.venv/bin/` stands for the interpreter that runs the tests.
- A `text` block right after one of them is what it prints on standard output; `...` stands for anything, and
  `<BLANKLINE>` for an empty line. What the program complains of on standard error stands in the block, or in the text
  of the page.
- A block of any kind with a file name, such as `toml mine.toml`, is written to that file.
- Other blocks are not run, but for `toml` ones that begin with a schema, which must be scenarios, simulations,
  registrations or drives.
"""

import contextlib
import io
import os
import re
import subprocess
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import needleplan as npl
from needleplan.anatomy import AnatomyFile
from needleplan.devices.cia402 import DrivesSetup
from needleplan.estimation import Registration
from needleplan.simulation import Simulation
from needleplan.sweep import Sweep

ROOT = Path(__file__).parent.parent
HOME = "https://github.com/needleplan/needleplan/"
RAW = "https://raw.githubusercontent.com/needleplan/needleplan/main/"
_BLOCK = re.compile(r"^```(\w+)(?: (\S+))?\n(.*?)^```$", re.MULTILINE | re.DOTALL)
_KINDS = {
    "needleplan.anatomy/1": AnatomyFile,
    "needleplan.simulation/1": Simulation,
    "needleplan.sweep/1": Sweep,
    "needleplan.registration/1": Registration,
    "needleplan.drives/1": DrivesSetup,
}
_NUMBER = r"-?\d+(?:\.\d+)?"
# What a page may tell in other words than is printed. A number with an ellipsis is the beginning of one.
_PART = re.compile(rf"(\.\.\.|(?<![\w.]){_NUMBER}(?![\w.]|\.\.\.)|(?<![\w.]){_NUMBER}(?=\.(?:\s|$)))")
# Largest relative difference of a number that a page tells from the one printed.
_RELATIVE = 0.05
# Begin of the lines in which the program complains, on standard error.
_COMPLAINT = "needleplan: "
_LINK = re.compile(r"\]\(([^)\s]+)\)")


@dataclass(frozen=True)
class Block:
    """A fenced block: its language, its file name where it has one, its text and the line of the page."""

    language: str
    file: str
    text: str
    line: int


def blocks(page: Path) -> Iterator[Block]:
    """Yield the fenced blocks of a page."""
    content = page.read_text(encoding="utf-8")
    for match in _BLOCK.finditer(content):
        yield Block(match[1], match[2] or "", match[3], content.count("\n", 0, match.start()) + 2)


def run(page: Path, folder: Path, tolerances: Mapping[str, tuple[float, float]] | None = None) -> None:
    """Run all blocks of a page in `folder`, which must be the working folder.

    `tolerances` has, for the language of a block, the absolute and the relative difference that a printed number may
    have from the one of the page; 5 % without them.
    """
    allowed, content = (0.0, _RELATIVE), " ".join(page.read_text(encoding="utf-8").split())
    namespace: dict[str, Any] = {"__name__": page.stem}
    printed: str | None = None
    for block in blocks(page):
        place = f"{page.name}:{block.line}"
        if block.file:
            (folder / block.file).write_text(block.text, encoding="utf-8")
        if block.language == "text" and printed is not None:
            lines = block.text.splitlines(keepends=True)
            told = "".join(line for line in lines if not line.startswith(_COMPLAINT) or line.strip() in printed)
            assert agrees(told, printed, *allowed), f"{place} differs from what was printed:\n{printed}"
            printed = None
        elif block.language == "python":
            allowed = (tolerances or {}).get("python", (0.0, _RELATIVE))
            printed = _run_python(block, place, namespace)
        elif block.language == "sh":
            allowed = (tolerances or {}).get("sh", (0.0, _RELATIVE))
            printed, complaints = _run_shell(block, place)
            # With `|| true` the page says that the answer does not matter.
            untold = [each for each in complaints if each not in content and "|| true" not in block.text]
            assert not untold, f"{place}: the page does not tell what the program says:\n" + "\n".join(untold)
        else:
            printed = None
            if block.language == "toml" and block.text.startswith("schema"):
                kind: Any = next((kind for schema, kind in _KINDS.items() if schema in block.text), npl.Scenario)
                kind.from_toml(block.text, place)


def agrees(told: str, printed: str, absolute: float = 0.0, relative: float = _RELATIVE) -> bool:
    """Return whether what a page tells agrees with what was printed; `...` stands for anything.

    The words must be the same, and each number within `absolute` + `relative` times the one told, or within one unit of
    the last decimal place told.
    """
    parts = _PART.split(" ".join(told.replace("<BLANKLINE>", "").split()))
    pattern = "".join(
        re.escape(part) if number % 2 == 0 else ".*?" if part == "..." else rf"(?<![\w.])({_NUMBER})(?!\w|\.\d)"
        for number, part in enumerate(parts)
    )
    match = re.fullmatch(pattern, " ".join(printed.split()))
    if match is None:
        return False
    numbers = [part for part in parts[1::2] if part != "..."]
    return all(
        abs(float(one) - float(other)) <= max(absolute + relative * abs(float(one)), 1.001 * _last_place(one))
        for one, other in zip(numbers, match.groups(), strict=True)
    )


def _last_place(number: str) -> float:
    """Return the unit of the last decimal place of a number; 0 for whole numbers."""
    decimals = number.partition(".")[2]
    return 10.0 ** -len(decimals) if decimals else 0.0


def test_file(name: str) -> Path:
    """Return the file of tests that a page names by its folder and stem: `safety/guard` is test_guard.py in safety."""
    folder, stem = name.split("/")
    (file,) = [each for each in (ROOT / "tests").rglob(f"test_{stem}.py") if each.parent.name == folder]
    return file


def broken_links(page: Path) -> list[str]:
    """Return the links of a page, relative or into this repository, that lead nowhere."""
    targets = [target.split("#")[0] for target in _LINK.findall(page.read_text(encoding="utf-8"))]
    own = re.compile(rf"{re.escape(HOME)}(?:blob|tree)/main/|{re.escape(RAW)}")
    files = [(target, ROOT / own.sub("", target) if own.match(target) else page.parent / target) for target in targets]
    return [
        target for target, file in files if target and (own.match(target) or ":" not in target) and not file.exists()
    ]


def environment() -> dict[str, str]:
    """Return the environment of a shell in which `needleplan` is the one under test."""
    return {**os.environ, "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}


def _run_python(block: Block, place: str, namespace: dict[str, Any]) -> str:
    output = io.StringIO()
    with contextlib.redirect_stdout(output):
        exec(compile("\n" * (block.line - 1) + block.text, place, "exec"), namespace)
    return output.getvalue()


def _run_shell(block: Block, place: str) -> tuple[str, list[str]]:
    """Return what a block prints, and what the program complains of."""
    script = block.text.replace(".venv/bin/", "")
    done = subprocess.run(
        ["bash", "-euo", "pipefail", "-c", script],
        env=environment(),
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )
    assert done.returncode == 0, f"{place}: exit code {done.returncode}\n{done.stdout}{done.stderr}"
    lines = [line for line in done.stderr.splitlines() if line.startswith(_COMPLAINT)]
    return done.stdout, [" ".join(line.removeprefix(_COMPLAINT).split()) for line in lines]
