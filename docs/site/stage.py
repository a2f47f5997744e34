"""Stages the sources of the site: pages of docs, results of the benches, the reference of the Python interface.

The pages of `docs` are plain Markdown that GitHub shows as it stands. What only a site needs is added to copies: the
tables of contents, which follow the list in `docs/README.md`, and addresses of files that are no pages of the site.
"""

import functools
import re
import shutil
from pathlib import Path

import contents
import interface
import notebooks
import validation
from contents import Section
from needleplan.cli.program import make_parser

DOCS = Path(__file__).parent.parent
ROOT = DOCS.parent
SOURCES = "https://github.com/needleplan/needleplan/blob/main"
PICTURES = "https://raw.githubusercontent.com/needleplan/needleplan/main"
SECTIONS = ("tutorials", "how-to", "reference", "explanation")
COMMANDS = DOCS / "reference" / "cli.md"
RESULTS = ROOT / "benches" / "results"
_LINK = re.compile(r"(\]\()([^)\s#]+)((?:#[^)\s]*)?\))")
_FENCE = re.compile(r"^(```.*?^```$)", re.MULTILINE | re.DOTALL)


def stage(folder: Path, *, quick: bool = False) -> None:
    """Write all sources of the site into an empty folder; if `quick`, notebooks without their output."""
    for original, copy in _pages().items():
        (folder / copy).parent.mkdir(parents=True, exist_ok=True)
        text = relinked(original.read_text(encoding="utf-8"), original, copy)
        if not text.startswith("# "):
            text = f"# {title(copy)}\n\n{text}"
        if original == COMMANDS:
            text = with_help(text)
        (folder / copy).write_text(text, encoding="utf-8")
    for picture in [*(DOCS / "images").iterdir(), *RESULTS.glob("*.png"), ROOT / "benches" / "history.png"]:
        copy = _staged(picture)
        (folder / copy).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(picture, folder / copy)
    shutil.copytree(DOCS / "gallery", folder / "scenes")
    if quick:
        shutil.copytree(DOCS / "notebooks", folder / "notebooks")
    else:
        notebooks.write(folder / "notebooks", sorted((DOCS / "notebooks").glob("*.ipynb")))
    listing = (DOCS / "README.md").read_text(encoding="utf-8")
    checked = validation.write(folder / "validation", quick=quick)
    parts = [*contents.sections(listing), checked, *_further_sections(folder)]
    for each in parts:
        each.write(folder)
    front = relinked(listing, DOCS / "README.md", Path("index.md"))
    front = front.replace("\n## ", f"\n{_moving_picture()}\n\n## ", 1)
    tree = contents.tree(["gallery/index", *(f"{each.folder}/index" for each in parts)])
    (folder / "index.md").write_text(f"{front}\n{tree}", encoding="utf-8")


def _moving_picture() -> str:
    """Return the moving picture of the README, as the front page of the site shows it."""
    (found,) = re.findall(r"^!\[.*\]\(.*\.gif\)$", (ROOT / "README.md").read_text(encoding="utf-8"), re.MULTILINE)
    return relinked(found, ROOT / "README.md", Path("index.md"))


def _further_sections(folder: Path) -> list[Section]:
    """Return the sections that `docs/README.md` does not list; writes the pages of the Python interface."""
    modules = interface.write(folder / "interface")
    results = ["benches", *(each.stem for each in sorted(RESULTS.glob("*.md")))]
    project = {"CHANGELOG": "Changes", "CONTRIBUTING": "Contributing"}
    return [
        Section("Interface", "interface", contents.listed({f"{name}.rst": name for name in modules}), modules),
        Section("Results", "results", contents.listed({f"{name}.md": title(Path(name)) for name in results}), results),
        Section("Project", "project", contents.listed({f"{name}.md": project[name] for name in project}), [*project]),
    ]


def relinked(text: str, original: Path, copy: Path) -> str:
    """Return a page in which links to other files lead to their copies on the site, or to GitHub."""

    def replaced(match: re.Match[str]) -> str:
        own = next((each for each in (SOURCES, PICTURES) if match[2].startswith(f"{each}/")), None)
        if ":" in match[2] and own is None:
            return match[0]
        target = ROOT / match[2].removeprefix(f"{own}/") if own else (original.parent / match[2]).resolve()
        staged = _staged(target)
        if staged is None:
            return f"{match[1]}{SOURCES}/{target.relative_to(ROOT)}{match[3]}"
        up = "../" * (len(copy.parts) - 1)
        return f"{match[1]}{up}{staged}{match[3]}"

    # Code is left as it is.
    return "".join(part if part.startswith("```") else _LINK.sub(replaced, part) for part in _FENCE.split(text))


def with_help(text: str) -> str:
    """Return the page of the command line, in which the section of each command begins with its `--help`."""
    for name, parser in make_parser().commands().items():
        heading = f"\n## {name}\n"
        text = text.replace(heading, f"{heading}\n```text\n{parser.format_help()}```\n", 1)
    return text


def title(page: Path) -> str:
    """Return a title for a page without one, from the name of its file."""
    return page.stem.replace("_", " ").capitalize()


@functools.cache
def _pages() -> dict[Path, Path]:
    """Return the copy of each page, by the page."""
    pages = {page: page.relative_to(DOCS) for section in SECTIONS for page in sorted((DOCS / section).glob("*.md"))}
    pages |= {page: Path("results") / page.name for page in sorted(RESULTS.glob("*.md"))}
    pages |= {page: Path("project") / page.name for page in (ROOT / "CHANGELOG.md", ROOT / "CONTRIBUTING.md")}
    return pages | {ROOT / "benches" / "README.md": Path("results") / "benches.md"}


def _staged(file: Path) -> Path | None:
    """Return the path of the copy of a file, None if the site has none."""
    if file == DOCS / "README.md":
        return Path("index.md")
    if file == DOCS / "gallery":
        return Path("gallery") / "index.rst"
    if file in _pages():
        return _pages()[file]
    if file.suffix == ".png" and file.parent == RESULTS:
        return Path("results") / file.name
    if file.suffix == ".png" and file.parent == ROOT / "benches":
        return Path("results") / file.name
    return file.relative_to(DOCS) if file.parent in (DOCS / "images", DOCS / "notebooks") else None
