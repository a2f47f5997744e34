"""Checks the links of the built site: every file and every place in a page that an internal link names is there."""

from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit


class Page(HTMLParser):
    """A page of the site: the places that links may name, and the links."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.places: set[str] = set()
        self.links: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Collect what an element offers and what it names."""
        for key, value in attrs:
            if key in ("id", "name") and value:
                self.places.add(value)
            elif key in ("href", "src") and value and tag != "base":
                self.links.append(value)


def pages_of(folder: Path) -> list[Path]:
    """Return the pages of the site, without the templates that the theme leaves in `_static`."""
    return sorted(each for each in folder.rglob("*.html") if "_static" not in each.parts)


def broken(folder: Path) -> list[str]:
    """Return the internal links of all pages in a folder that lead nowhere, as `page: link`."""
    pages = {file: Page(file.read_text(encoding="utf-8")) for file in pages_of(folder)}
    return [
        f"{file.relative_to(folder)}: {link}"
        for file, page in pages.items()
        for link in page.links
        if not _leads_somewhere(file, link, pages)
    ]


def external_sources(folder: Path) -> Iterator[str]:
    """Yield each script, picture and style sheet that a page would fetch from another server."""
    for file in pages_of(folder):
        for tag in _Fetched(file.read_text(encoding="utf-8")).addresses:
            yield f"{file.relative_to(folder)}: {tag}"


class _Fetched(HTMLParser):
    """Addresses on other servers that a browser fetches by itself."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.addresses: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Collect the address of a script, picture, frame or style sheet."""
        found = dict(attrs)
        address = found.get("href") if tag == "link" and found.get("rel") == "stylesheet" else found.get("src")
        if address and urlsplit(address).netloc:
            self.addresses.append(address)


def _leads_somewhere(file: Path, link: str, pages: dict[Path, Page]) -> bool:
    parts = urlsplit(link)
    if parts.scheme or parts.netloc:
        return True
    target = (file.parent / unquote(parts.path)).resolve() if parts.path else file
    if target.is_dir():
        target = target / "index.html"
    if target not in pages:
        return target.is_file()
    return not parts.fragment or unquote(parts.fragment) in pages[target].places
