"""Measure the share of small changes (mutants) of the safety guard that its tests find.

python benches/python/mutation.py --json benches/results/mutation.json > benches/results/mutation.md
python benches/python/mutation.py --mutants 5              # short test run

Needs cosmic-ray, whose operators make the mutants: each changes one place, such as a comparison, a number, a boolean
operator, a loop. Of the places of `control/safety`, a seeded sample is drawn, and of the operators of a place one. For
each mutant the tests of `tests/control/safety` run in a copy of the sources until the first failure. A failed test runs
once more alone, so that a busy machine kills no mutant. Type annotations and decorators are left out. With `--again`,
only the surviving mutants of the JSON file run again.
"""

import argparse
import importlib
import json
import math
import os
import random
import re
import shutil
import signal
import sys
import tempfile
import time
import traceback
from collections import Counter
from dataclasses import asdict, dataclass
from pathlib import Path

import machine
from cosmic_ray.ast import Visitor, get_ast
from cosmic_ray.mutating import mutate_code
from cosmic_ray.plugins import get_operator, operator_names

SOURCE = "python/needleplan/control/safety"
# The tests in the order of their time; marked slow are only those that search farther for the same.
TESTS = [f"tests/control/safety/test_{name}.py" for name in (
    "boundaries", "limits", "motion", "guard", "retraction", "delay", "machine", "explorer", "histories", "watchdog",
    "orders", "pages", "fine_points",
)]  # fmt: skip
FIRST = {
    "_states": ("machine", "orders"), "_motion": ("motion", "boundaries"), "_wire": ("guard", "watchdog"),
    "_limits": ("limits", "boundaries", "pages"), "_inputs": ("boundaries", "delay"), "_watchdog": ("watchdog",),
    "_core": ("guard", "watchdog"), "_guard": ("guard", "retraction"), "_table": ("pages",),
}  # fmt: skip
PRELOADED = ("pytest", "hypothesis", "numpy", "scipy", "needleplan", "needleplan.devices", "needleplan.devices.robot",
             "needleplan.recording", "needleplan.planning", "needleplan.simulation")  # fmt: skip
PRELOADING = "ignore:Module already imported so cannot be rewritten"
TIMEOUT_S = 300
COPIED = ("python", "tests", "docs", "benches", "scenarios")
KILLED, SURVIVED, EQUIVALENT = "killed", "survived", "equivalent"


@dataclass
class Mutant:
    """One change: the file, the line (from 1), the column, the operator of cosmic-ray, its number in the file."""

    file: str
    line: int
    column: int
    operator: str
    number: int
    text: str
    verdict: str = ""


class _Places(Visitor):
    """Collects the positions that an operator can change."""

    def __init__(self, operator: str) -> None:
        self.operator = get_operator(operator)()
        self.found: list[tuple[int, int]] = []

    def visit(self, node: object) -> object:
        """Collect the positions at a node."""
        self.found += [begin for begin, _ in self.operator.mutation_positions(node)]
        return node


def mutants(root: Path) -> list[Mutant]:
    """Return every mutant of every place."""
    found = []
    for file in sorted((root / SOURCE).glob("*.py")):
        text = file.read_text()
        lines, tree = text.splitlines(), get_ast(text)
        for operator in operator_names():
            if "BitOr" in operator or "RemoveDecorator" in operator or get_operator(operator).arguments():
                continue
            places = _Places(operator)
            places.walk(tree)
            found += [
                Mutant(str(file.relative_to(root)), line, column, operator, number, lines[line - 1].strip())
                for number, (line, column) in enumerate(places.found)
            ]
    return found


def sample(every: list[Mutant], size: int, seed: int) -> list[Mutant]:
    """Return a sample of places, with one random operator for each."""
    draw, places = random.Random(seed), {}
    for each in sorted(every, key=lambda each: (each.file, each.line, each.column, each.operator, each.number)):
        places.setdefault((each.file, each.line, each.column), []).append(each)
    picked = [draw.choice(group) for group in places.values()]
    return draw.sample(picked, min(size, len(picked)))


def verdict(mutant: Mutant, root: Path) -> str:
    """Return what the tests say about a mutant in the copy `root` of the sources."""
    file = root / mutant.file
    text = file.read_text()
    changed = mutate_code(text, get_operator(mutant.operator)(), mutant.number)
    if changed is None or changed == text:
        return EQUIVALENT
    file.write_text(changed)
    try:
        return SURVIVED if passes(root, file.stem) else KILLED
    finally:
        file.write_text(text)


def passes(root: Path, first: str = "") -> bool:
    """Return whether the tests pass in the copy `root`; a test that fails counts if it fails again alone.

    `first` names the module whose tests run first.
    """
    shutil.rmtree(root / SOURCE / "__pycache__", ignore_errors=True)
    tests = sorted(TESTS, key=lambda each: Path(each).stem.removeprefix("test_") not in FIRST.get(first, ()))
    code, said = _in_child(root, tests)
    failed = re.findall(r"^(?:FAILED|ERROR) (\S+)", said, re.MULTILINE)
    if code == 0:
        return True
    if code is None or not failed:  # too slow, or an error before any test
        return False
    return _in_child(root, failed)[0] == 0


def _in_child(root: Path, tests: list[str]) -> tuple[int | None, str]:
    """Run tests in a fork of this process, which has imported everything but the guard and its tests."""
    said = root / "said.txt"
    child = os.fork()
    if child == 0:
        code = 70
        try:
            os.setsid()
            os.chdir(root)
            stream = os.open(said, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o644)
            os.dup2(stream, 1)
            os.dup2(stream, 2)
            pytest = importlib.import_module("pytest")
            options = ["-x", "-q", "-m", "not slow", "-p", "no:cacheprovider", "-W", PRELOADING]
            code = int(pytest.main([*options, *tests]))
            sys.stdout.flush()
        except BaseException:
            traceback.print_exc()
        finally:
            os._exit(code)  # the child must not leave this function: the folder belongs to the parent
    until_s = time.monotonic() + TIMEOUT_S
    while time.monotonic() < until_s:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status), said.read_text()
        time.sleep(0.02)
    os.killpg(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return None, said.read_text()


def preload(root: Path) -> None:
    """Import from the copy what the tests need besides the guard, so that a fork need not."""
    os.environ["CI"] = "true"  # hypothesis then has no deadlines, and draws the same examples every time
    sys.path[:0] = [str(root / "python"), str(root)]
    for name in PRELOADED:
        importlib.import_module(name)
    assert not any(name.startswith("needleplan.control") for name in sys.modules)


def wilson(hits: int, total: int) -> tuple[float, float]:
    """Return the 95 % interval of a share by Wilson."""
    z, share = 1.959964, hits / total
    middle = (share + z * z / (2 * total)) / (1 + z * z / total)
    half = z * math.sqrt(share * (1 - share) / total + z * z / (4 * total * total)) / (1 + z * z / total)
    return middle - half, middle + half


def report(found: list[Mutant], equivalents: dict[str, str]) -> str:
    """Return the score and the surviving mutants as Markdown."""
    counts, total = Counter(each.verdict for each in found), len(found)
    judged = total - counts[EQUIVALENT]
    low, high = wilson(counts[KILLED], judged)
    raw_low, raw_high = wilson(counts[KILLED], total)
    lines = [
        f"| sampled | killed | equivalent | survived | score | 95 % interval |\n|--:|--:|--:|--:|--:|--:|\n"
        f"| {total} | {counts[KILLED]} | {counts[EQUIVALENT]} | {counts[SURVIVED]} | {counts[KILLED] / judged:.1%} | "
        f"{low:.1%} to {high:.1%} |",
        f"If equivalent mutants counted as survived: {counts[KILLED] / total:.1%}, {raw_low:.1%} to {raw_high:.1%}.",
        "| mutant | operator | | |\n|---|---|---|---|",
    ]
    rows = [
        f"| {shown(each)} | {each.operator.split('/')[1]} | {each.verdict} | {equivalents.get(key(each), '')} |"
        for each in found if each.verdict != KILLED
    ]  # fmt: skip
    return "\n\n".join(lines) + "\n" + "\n".join(rows)


def shown(mutant: Mutant) -> str:
    """Return the place of a mutant for a cell of a Markdown table."""
    text = mutant.text.replace("|", "\\|")
    return f"`{Path(mutant.file).name}`: `{text}`"


def key(mutant: Mutant) -> str:
    """Return the name under which mutation_equivalents.json explains an equivalent mutant."""
    return f"{Path(mutant.file).name}: {mutant.text} [{mutant.operator.split('/')[1]}, {mutant.column}]"


def main() -> None:
    """Run the mutants and print the report; the JSON file is written after each one, and continued if it is there."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--mutants", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--again", action="store_true", help="run the surviving mutants of the JSON file again")
    options = parser.parse_args()
    reasons = Path(__file__).with_name("mutation_equivalents.json")
    equivalents: dict[str, str] = json.loads(reasons.read_text()) if reasons.exists() else {}
    before: dict[tuple[object, ...], Mutant] = {}
    if options.json and options.json.exists():
        for each in json.loads(options.json.read_text())["mutants"]:
            told = Mutant(**each)
            before[told.file, told.text, told.column, told.operator] = told
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        for name in COPIED:
            shutil.copytree(machine.ROOT / name, root / name, ignore=shutil.ignore_patterns("__pycache__"))
        shutil.copy(machine.ROOT / "pyproject.toml", root)
        preload(root)
        code, said = _in_child(root, TESTS)
        if code:
            raise SystemExit(f"the tests fail without a mutant:\n{said[-2000:]}")
        every = mutants(root)
        chosen = list(before.values()) if options.again else sample(every, options.mutants, options.seed)
        places = len({(each.file, each.line, each.column) for each in every})
        now = {(each.file, each.text, each.column, each.operator): each for each in every}
        for at, each in enumerate(chosen):
            told = before.get((each.file, each.text, each.column, each.operator))
            if key(each) in equivalents:
                each.verdict = EQUIVALENT
            elif told is not None and told.verdict and not (options.again and told.verdict == SURVIVED):
                each.verdict = told.verdict
            else:
                source = now[each.file, each.text, each.column, each.operator] if options.again else each
                each.verdict = verdict(source, root)
            print(f"{at + 1}/{len(chosen)} {each.verdict} {key(each)}", file=sys.stderr, flush=True)
            if options.json:
                about = {**machine.description(), "seed": options.seed, "mutants_in_all": len(every), "places": places}
                rest = [asdict(one) for one in chosen]
                options.json.write_text(json.dumps({"about": about, "mutants": rest}, indent=1) + "\n")
    print(f"{len(every)} mutants at {places} places, seed {options.seed}, commit {machine.commit()}.\n")
    print(report(chosen, equivalents))


if __name__ == "__main__":
    main()
