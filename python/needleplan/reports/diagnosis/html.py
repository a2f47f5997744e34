"""HTML text of a self-contained page and its elements. A page has no scripts, loads no files and has one `h1`."""

from __future__ import annotations

import base64
import math
from collections.abc import Iterable, Sequence
from html import escape
from pathlib import Path

__all__ = ["heading", "items", "page", "paragraph", "picture", "table"]

_STYLE = Path(__file__).with_name("report.css")


def page(title: str, body: Iterable[str]) -> str:
    """Return the HTML text of a page. `title` is also the first heading; `body` holds the HTML text of the elements."""
    return "\n".join([
        "<!DOCTYPE html>",
        '<html lang="en">',
        "<head>",
        '<meta charset="utf-8">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        # Forbids requests, even if a data file contains HTML.
        "<meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; img-src data:; "
        "style-src 'unsafe-inline'\">",
        f"<title>{escape(title)}</title>",
        f"<style>{_STYLE.read_text(encoding='utf-8')}</style>",
        "</head>",
        "<body>",
        "<main>",
        f"<h1>{escape(title)}</h1>",
        *body,
        "</main>",
        "</body>",
        "</html>",
        "",
    ])  # fmt: skip


def heading(text: str, order: int = 2) -> str:
    """Return the HTML text of a heading: `order` 2 for a section, 3 for a part of a section."""
    return f"<h{order}>{escape(text)}</h{order}>"


def paragraph(text: str, kind: str = "") -> str:
    """Return the HTML text of a paragraph; `kind` is its CSS class."""
    return f'<p class="{escape(kind)}">{escape(text)}</p>' if kind else f"<p>{escape(text)}</p>"


def items(texts: Iterable[str]) -> str:
    """Return the HTML text of a bulleted list."""
    return "<ul>\n" + "\n".join(f"<li>{escape(text)}</li>" for text in texts) + "\n</ul>"


def table(caption: str, columns: Sequence[str], rows: Iterable[Sequence[str | float | int | None]]) -> str:
    """Return the HTML text of a table.

    The first cell of a row is the heading of the row. Numbers are aligned right; None and NaN are shown as a dash.
    """
    lines = ['<div class="scroll"><table>', f"<caption>{escape(caption)}</caption>", "<thead><tr>"]
    lines += [f'<th scope="col">{escape(column)}</th>' for column in columns]
    lines.append("</tr></thead><tbody>")
    for first, *others in rows:
        lines.append(f'<tr><th scope="row">{_cell(first)}</th>' + "".join(_td(other) for other in others) + "</tr>")
    return "\n".join([*lines, "</tbody></table></div>"])


def picture(svg: str, alternative: str, caption: str = "") -> str:
    """Return the HTML text of the figure `svg`. `alternative` describes the figure for readers who cannot see it."""
    data = base64.b64encode(svg.encode()).decode("ascii")
    below = f"<figcaption>{escape(caption)}</figcaption>" if caption else ""
    return f'<figure><img src="data:image/svg+xml;base64,{data}" alt="{escape(alternative)}">{below}</figure>'


def _td(each: str | float | int | None) -> str:
    kind = ' class="number"' if isinstance(each, int | float) else ""
    return f"<td{kind}>{_cell(each)}</td>"


def _cell(each: str | float | int | None) -> str:
    if each is None or (isinstance(each, float) and math.isnan(each)):
        return "&ndash;"
    return f"{each:.4g}" if isinstance(each, float) else escape(str(each))
