"""Measure which share of small changes (mutants) of the crate `rust/guard` its own tests find.

python benches/python/mutation_crate.py --count 120 --seed 1 > benches/results/mutation_crate.md

Every operator, number and truth value of the code is a place for a mutant; `--count` of them are drawn with `--seed`. A
mutant that does not compile is replaced by the next one that is drawn. A mutant is found if a test fails or takes more
than `--timeout` seconds. The tests in C and those in Python do not run.
"""

from __future__ import annotations

import argparse
import collections
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
CRATE = ROOT / "rust" / "guard"
FILES = ("invariants", "line", "properties", "session", "supervisor", "transitions")
TESTS = ("--lib", *(f"--test={name}" for name in FILES))

# What is changed, and into what; `\1` and `\2` stay.
CHANGES = [
    (r" < ", " <= "), (r" <= ", " < "), (r" > ", " >= "), (r" >= ", " > "), (r" == ", " != "), (r" != ", " == "),
    (r" && ", " || "), (r" \|\| ", " && "), (r" \+ ", " - "), (r" - ", " + "), (r" \* ", " / "), (r" \| ", " & "),
    (r" & ", " | "), (r" \^ ", " | "), (r"\btrue\b", "false"), (r"\bfalse\b", "true"), (r"\bmin\(", "max("),
    (r"\bmax\(", "min("), (r"(?<=[ (])!(?=[a-z(])", ""), (r"is_some\b", "is_none"), (r"is_none\b", "is_some"),
    (r"(?<![\w.])(\d+)(?![\w.])", lambda found: str(int(found[1]) + 1)), (r"wrapping_add\(", "wrapping_sub("),
    (r"saturating_sub\(", "saturating_add("), (r"saturating_add\(", "saturating_sub("),
]  # fmt: skip


@dataclass(frozen=True)
class Mutant:
    """A changed line of a file."""

    file: Path
    line: int
    before: str
    after: str

    def __str__(self) -> str:
        return f"`{self.file.name}:{self.line}` `{self.before.strip()}` -> `{self.after.strip()}`".replace("|", "\\|")


def mutants() -> list[Mutant]:
    """Return all mutants of the crate; comments, attributes, its tests and the functions for C are left out."""
    found = []
    for file in sorted((CRATE / "src").glob("*.rs")):
        if file.name == "c.rs":
            continue
        for number, line in enumerate(file.read_text().split("#[cfg(test)]")[0].splitlines(), 1):
            code = line.split("//")[0]
            if not code.strip() or code.strip().startswith(("#", "use ", "pub mod ", "mod ")):
                continue
            for pattern, change in CHANGES:
                for place in re.finditer(pattern, code):
                    after = change if isinstance(change, str) else change(place)
                    found.append(Mutant(file, number, line, code[: place.start()] + after + code[place.end() :]))
    return found


def verdict(mutant: Mutant, copy: Path, timeout_s: float) -> str:
    """Return "found", "survived" or "does not compile"."""
    file = copy / "guard" / "src" / mutant.file.name
    original = mutant.file.read_text()
    lines = original.splitlines(keepends=True)
    lines[mutant.line - 1] = mutant.after + "\n"
    file.write_text("".join(lines))
    cargo = ["cargo", "test", "--offline", "--quiet", "--manifest-path", str(copy / "Cargo.toml"), *TESTS]
    environment = {
        **os.environ,
        "CARGO_TARGET_DIR": str(copy / "target"),
        "PROPTEST_CASES": "64",
        "RUST_BACKTRACE": "0",
    }
    try:
        built = subprocess.run([*cargo, "--no-run"], env=environment, capture_output=True, check=False, timeout=600)
        if built.returncode:
            return "does not compile"
        quiet = subprocess.DEVNULL
        tests = subprocess.Popen(cargo, env=environment, stdout=quiet, stderr=quiet, start_new_session=True)
        try:
            return "found" if tests.wait(timeout_s) else "survived"
        except subprocess.TimeoutExpired:
            os.killpg(tests.pid, signal.SIGKILL)  # cargo and the test that does not end
            tests.wait()
            return "found"
    except subprocess.TimeoutExpired:
        return "found"
    finally:
        file.write_text(original)


def main() -> None:
    """Draw mutants, test each, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=64)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--timeout", type=float, default=60.0, metavar="S")
    options = parser.parse_args()
    places = mutants()
    random.Random(options.seed).shuffle(places)
    verdicts: dict[Mutant, str] = {}
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder)
        shutil.copytree(CRATE, copy / "guard")
        text = (ROOT / "Cargo.toml").read_text()
        text = re.sub(r"members = \[.*?\]", 'members = ["guard"]', text)
        text = re.sub(r'path = "rust/guard"', 'path = "guard"', text)
        text = re.sub(
            r"(?m)^(ppvi|needle) = .*\n|^\[profile\.dev\.package\.(ppvi|needle)\]\nopt-level = \d\n", "", text
        )
        (copy / "Cargo.toml").write_text(text)
        shutil.copy(ROOT / "Cargo.lock", copy)
        for mutant in places:
            if sum(each != "does not compile" for each in verdicts.values()) == options.count:
                break
            verdicts[mutant] = verdict(mutant, copy, options.timeout)
            print(verdicts[mutant], mutant, file=sys.stderr, flush=True)
    drawn = [mutant for mutant, each in verdicts.items() if each != "does not compile"]
    survivors = [mutant for mutant in drawn if verdicts[mutant] == "survived"]
    print("# Mutants of the crate of the guard\n")
    print(f"{len(drawn)} of {len(places)} mutants, seed {options.seed}; the tests are those of the crate in Rust.\n")
    print("| file | mutants | found |\n|---|--:|--:|")
    files = collections.Counter(mutant.file.name for mutant in drawn)
    for name, number in sorted(files.items()):
        print(f"| `{name}` | {number} | {number - sum(each.file.name == name for each in survivors)} |")
    share = (len(drawn) - len(survivors)) / max(len(drawn), 1)
    print(f"| all | {len(drawn)} | {len(drawn) - len(survivors)} ({share:.0%}) |\n")
    print("Not found:\n" if survivors else "All were found.")
    for mutant in survivors:
        print(f"- {mutant}")


if __name__ == "__main__":
    main()
