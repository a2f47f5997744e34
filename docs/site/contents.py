"""Tables of contents of the site, from the list of pages in `docs/README.md`."""

import re
from dataclasses import dataclass
from pathlib import Path

_ENTRY = re.compile(r"^- \[([^]]+)\]\(([a-z-]+)/([a-z-]+)\.(?:md|ipynb)\)", re.MULTILINE)

_FOLDERS = {"Begin": "tutorials", "How to": "how-to"}  # folders of sections, where not the title itself


@dataclass
class Section:
    """A section of the site: its title, its folder, the text of its page, and the pages below it."""

    title: str
    folder: str
    text: str
    pages: list[str]

    def write(self, source: Path) -> None:
        """Write the page of the section."""
        folder = source / self.folder
        folder.mkdir(exist_ok=True)
        (folder / "index.md").write_text(f"# {self.title}\n\n{self.text}\n\n{tree(self.pages)}", encoding="utf-8")


def sections(listing: str) -> list[Section]:
    """Return the sections that the list of pages names."""
    found = []
    for part in listing.split("\n## ")[1:]:
        title, text = part.split("\n", 1)
        entries = [(folder, page) for _, folder, page in _ENTRY.findall(text)]
        pages = [f"/{folder}/{page}" for folder, page in entries]
        folder = _FOLDERS.get(title, title.lower())
        found.append(Section(title, folder, re.sub(r"\]\((?=[a-z-]+/)", "](../", text).strip(), pages))
    return found


def listed(titles: dict[str, str]) -> str:
    """Return a list of links to pages, from their files and titles."""
    return "\n".join(f"- [{title}]({page})" for page, title in titles.items())


def tree(pages: list[str]) -> str:
    """Return a table of contents that the page itself does not show."""
    return "```{toctree}\n:hidden:\n\n" + "\n".join(pages) + "\n```\n"
