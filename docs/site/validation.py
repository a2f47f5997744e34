"""Writes the validation pages: what was published and measured beside what is computed, from `benches/results`.

No figure stands in this file. Tables come from the result files, which name the command that makes them.
"""

import json
import math
import re
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path
from typing import Any

from contents import Section

DOCS = Path(__file__).parent.parent
RESULTS = DOCS.parent / "benches" / "results"
HISTORY = RESULTS.parent / "history.jsonl"
CHAPTERS = {
    "ch2": "Chapter 2: axial force",
    "ch3": "Chapter 3: friction",
    "ch4": "Chapter 4: tissue motion",
    "ch5": "Chapter 5: deflection",
    "ch6": "Chapter 6: planning",
}
# Pages of tables that result files hold: title, introduction, and (file, pictures) in the order of the page.
PAGES = {
    "predictions": (
        "Predicted beside realised success",
        "What a table predicts, beside executions by an independent Monte-Carlo: our own at random poses, a second "
        "program that was written from the documentation, and 3D insertions.",
        (("predictions", ()), ("foreign_executions", ()), ("space_predictions", ()), ("space_insertions", ())),
    ),
    "solvers": (
        "Solvers beside their peers",
        "Time, error and memory of our solvers and of published ones, on the same problem and machine.",
        (("peers", ()), ("speed", ()), ("scaling", ("scaling.png",)), ("planners", ("planners.png",))),
    ),
    "diagnosis": (
        "Diagnosis on blind data",
        "Effects hidden by an independent generator: what the diagnosis said, beside what was true.",
        (
            ("diagnosis_evidence", ()),
            ("diagnosis_ablation", ()),
            ("diagnosis_tip", ("diagnosis_tip_confusion.png", "diagnosis_tip_power.png")),
            ("circle", ("circle.png",)),
        ),
    ),
    "intervals": (
        "Calibration of intervals",
        "How often an interval of 95 % holds the true value, in simulations with known truth.",
        (("trials", ()), ("fit_intervals", ()), ("curvature", ()), ("predicted_tip", ())),
    ),
    "targeting": (
        "Targeting with sensors",
        "Error at the target by the true tip, with curvature sensors and images beside the tracker alone, and time.",
        (("targeting", ()), ("tip_fibre", ()), ("sensor_times", ())),
    ),
    "real": (
        "Recordings of others",
        "Models and filters on recordings that other laboratories have published.",
        (("real_insertions", ()), ("real_adaptation", ()), ("liver_force", ())),
    ),
}
CONTEXT = "ours"  # verdict of rows that are compared with nothing
ORIGINS = {
    "thesis": "Numbers of the thesis",
    "earlier computation": "Numbers of an earlier computation of this project",
    "own goal": "Goals of this project",
    "none": "Context, compared with nothing",
}
_MOST_TABLES = 3  # number of tables of a result file that a page repeats; the file itself is linked


def write(folder: Path, *, quick: bool = False) -> Section:
    """Write all pages and return their section; if `quick`, without the report of a diagnosis."""
    folder.mkdir()
    listed = ["Tables are sorted by a click on a heading. Every page names the files of its figures.", ""]
    rows = json.loads((RESULTS / "reproduce.json").read_text(encoding="utf-8"))
    (folder / "published.md").write_text(published(rows), encoding="utf-8")
    listed.append("- [Published beside computed](published.md): every number of the thesis")
    for name, (title, text, files) in PAGES.items():
        (folder / f"{name}.md").write_text(results_page(title, text, files), encoding="utf-8")
        listed.append(f"- [{title}]({name}.md)")
    if not quick:
        write_report(folder / "report.html")
        example = "of the example in [Find what a model lacks](../how-to/diagnose.md)"
        listed.append(f"- [The report of one diagnosis](report.html), {example}")
    lines = HISTORY.read_text(encoding="utf-8").splitlines()
    (folder / "history.md").write_text(history([json.loads(line) for line in lines]), encoding="utf-8")
    listed.append("- [Benches over time](history.md)")
    return Section("Validation", folder.name, "\n".join(listed), ["published", *PAGES, "history"])


def write_report(file: Path) -> None:
    """Write the report that `needleplan diagnose` makes of the recordings in the page on diagnosis."""
    page = (DOCS / "how-to" / "diagnose.md").read_text(encoding="utf-8")
    code = re.search(r"^```python\n(.*?)^```$", page, re.MULTILINE | re.DOTALL)
    assert code, "the page on diagnosis has no block of Python"
    with tempfile.TemporaryDirectory() as folder:
        program = [sys.executable, "-m", "needleplan"]
        base = [*program, "identify", "shaft-and-tip", "data.csv", "-o", "model.toml"]
        command = [*program, "diagnose", "model.toml", "data.csv", "-o", "found"]
        for each in ([sys.executable, "-c", code[1]], base, command):
            subprocess.run(each, cwd=folder, check=True, capture_output=True)
        shutil.copy(Path(folder) / "found" / "report.html", file)


def published(rows: list[dict[str, Any]]) -> str:
    """Return the page of all published numbers, from the list that `needleplan reproduce --json` prints."""
    parts = ["# Published beside computed", ""]
    parts.append(
        "From `benches/results/reproduce.json`. What verdicts and kinds mean stands in the "
        "[reference](../reference/cli.md#reproduce); the [counts](../results/reproduce.md) by kind. "
        "The chapters hold numbers of the thesis, each with its place. Numbers of an earlier computation stand at the "
        "end. Goals of this project, and rows that are context, are counted and left out."
    )
    for origin, title in ORIGINS.items():
        verdicts = Counter(row["verdict"] for row in rows if row["origin"] == origin)
        parts += [
            "",
            f"{title}:",
            "",
            table(["verdict", "rows"], [[name, f"{n}"] for name, n in verdicts.most_common()]),
        ]
    for chapter, title in CHAPTERS.items():
        shown = [_cells(row, f"{chapter}/", "published") for row in beside_the_thesis(rows, chapter)]
        head = ["what", "thesis", "computed", "unit", "verdict", "kind", "reason", "source"]
        parts += ["", f"## {title}", "", table(head, shown)]
    shown = [_cells(row, "", "earlier")[:-1] for row in rows if row["origin"] == "earlier computation"]
    head = ["what", "earlier", "computed", "unit", "verdict", "kind", "reason"]
    parts += ["", "## Beside an earlier computation", "", "No evidence about the thesis.", "", table(head, shown)]
    return "\n".join(parts) + "\n"


def beside_the_thesis(rows: list[dict[str, Any]], chapter: str) -> list[dict[str, Any]]:
    """Return the rows of a chapter that compare with a number or statement of the thesis."""
    return [
        row
        for row in rows
        if row["id"].startswith(f"{chapter}/") and row["origin"] == "thesis" and row["verdict"] != CONTEXT
    ]


def _cells(row: dict[str, Any], prefix: str, key: str) -> list[str]:
    factor = f", factor {row['factor']:.2f}" if row["factor"] else ""
    return [
        row["id"].removeprefix(prefix),
        shortened(row[key]),
        shortened(row["ours"]),
        row["unit"],
        f"{row['verdict']}{factor}",
        row["kind"],
        row["reason"],
        row["source"].removeprefix("thesis, ").partition(":")[0],
    ]


def counts(rows: list[dict[str, Any]]) -> str:
    """Return the result page `reproduce.md`: a table of verdicts by kind for each origin."""
    kinds = ["computed", "round trip", "arithmetic", "qualitative", "fit of own data", "cannot be reproduced"]
    order = ["reproduced", "same order", "differs", "not reproduced", "cannot be reproduced", "no verdict"]
    order += ["ours", "met", "missed"]
    parts = [
        "# Verdicts of `needleplan reproduce` by kind",
        "",
        "`needleplan reproduce ch2 ch3 ch4 ch5 ch6`, default effort; the table is made from `reproduce.json` by",
        "`python docs/site/validation.py`. What origins, verdicts and kinds mean stands in the "
        "[reference](../../docs/reference/cli.md).",
    ]
    for origin, title in ORIGINS.items():
        chosen = [row for row in rows if row["origin"] == origin]
        lines = [["all", *([row for row in chosen if row["kind"] == kind] for kind in kinds), chosen]]
        lines[:0] = [
            [verdict, *([row for row in cells if row["verdict"] == verdict] for cells in lines[0][1:])]
            for verdict in order
            if any(row["verdict"] == verdict for row in chosen)
        ]
        cells = [[name, *(f"{len(cell)}" if cell else "" for cell in rest)] for name, *rest in lines]
        parts += ["", f"## {title}", "", table(["verdict", *kinds, "all"], cells)]
    return "\n".join(parts) + "\n"


def results_page(title: str, text: str, files: tuple[tuple[str, tuple[str, ...]], ...]) -> str:
    """Return a page with the first tables and the pictures of result files."""
    parts = [f"# {title}", "", text]
    for name, pictures in files:
        parts += ["", f"## {name.replace('_', ' ').capitalize()}", "", f"From [all results](../results/{name}.md)."]
        for each in tables_of((RESULTS / f"{name}.md").read_text(encoding="utf-8"))[:_MOST_TABLES]:
            parts += ["", each]
        for picture in pictures:
            alternative = picture.removesuffix(".png").replace("_", " ")
            parts += ["", f"![{alternative}](../results/{picture})"]
    return "\n".join(parts) + "\n"


def history(runs: list[dict[str, Any]]) -> str:
    """Return the page of the tracked benches: the first run, the last run and their ratio."""
    first, last = runs[0], runs[-1]
    head = ["bench", f"{first['date'][:10]}, {first['commit']}", f"{last['date'][:10]}, {last['commit']}", "ratio"]
    count = f"{len(runs)} run" + ("s" if len(runs) > 1 else "")
    text = f"From `benches/history.jsonl`, {count} of `make track`: the first run, the last one, and their ratio."
    parts = ["# Benches over time", "", text, "", "![relative changes over the commits](../results/history.png)"]
    for title, key in (("Seconds", "figures"), ("Instructions", "instructions")):
        rows = [
            [name, shortened(first[key].get(name)), shortened(value), ratio(first[key].get(name), value)]
            for name, value in last[key].items()
        ]
        parts += ["", f"## {title}", "", table(head, rows)]
    return "\n".join(parts) + "\n"


def tables_of(text: str) -> list[str]:
    """Return the tables of a Markdown page, each as it stands there."""
    found: list[list[str]] = [[]]
    for line in text.splitlines():
        if line.startswith("|"):
            found[-1].append(line)
        elif found[-1]:
            found.append([])
    return ["\n".join(each) for each in found if len(each) > 1]


def table(head: list[str], rows: list[list[str]]) -> str:
    """Return a table in Markdown."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(
        "| " + " | ".join(cell.replace("|", "\\|").replace("\n", " ") for cell in row) + " |" for row in lines
    )


def shortened(value: Any) -> str:
    """Return a number with four significant digits, and anything else as text."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return "" if value is None else f"{value}"
    return f"{value:.4g}" if math.isfinite(value) else f"{value}"


def ratio(first: float | None, last: float) -> str:
    """Return the last figure over the first one, empty where there was none."""
    return f"{last / first:.2f}" if first else ""


if __name__ == "__main__":
    ROWS = json.loads((RESULTS / "reproduce.json").read_text(encoding="utf-8"))
    (RESULTS / "reproduce.md").write_text(counts(ROWS), encoding="utf-8")
