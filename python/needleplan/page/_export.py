"""The page of one plan in one file: styles, modules, data, and a policy that lets it load nothing else."""

from __future__ import annotations

import base64
import hashlib
import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from needleplan.page._packing import plain

__all__ = ["STATIC", "page_html"]

STATIC = Path(__file__).parent / "static"
"""Folder of the files of the page."""

# Prefix of the names under which the modules of an exported page import each other.
_PREFIX = "needleplan/"


def page_html(data: Mapping[str, Any], document: str = "index.html", module: str = "view.js") -> bytes:
    """Return the page as one HTML file that shows `data`, as `offline.js` reads it, without a server.

    `document` is the file of the page, and `module` its main module. The modules become data addresses of an import
    map, because browsers load no module from a neighbouring file.
    """
    imports = json.dumps({"imports": {f"{_PREFIX}{name}": _address(text) for name, text in _modules().items()}})
    entry = f'import "{_PREFIX}{module}";'
    style = (STATIC / "view.css").read_text(encoding="utf-8")
    icon = base64.b64encode((STATIC / "icon.svg").read_bytes()).decode()
    sources = " ".join(_digest(text) for text in (imports, entry))
    policy = f"default-src 'none'; script-src {sources} data:; style-src {_digest(style)}; img-src data: blob:"
    head = f"""<meta http-equiv="Content-Security-Policy" content="{policy}">
<link rel="icon" href="data:image/svg+xml;base64,{icon}">
<style>{style}</style>
<script type="importmap">{imports}</script>"""
    content = json.dumps(plain(data), allow_nan=False).replace("<", "\\u003c")
    tail = f"""<script type="application/json" id="data">{content}</script>
<script type="module">{entry}</script>
</body>"""
    page = (STATIC / document).read_text(encoding="utf-8")
    page = re.sub(r'<link rel="(icon|stylesheet|modulepreload)".*\n|<script type="module".*\n', "", page)
    page = page.replace("</head>", f"{head}\n</head>").replace("</body>", tail)
    return page.encode()


def _modules() -> dict[str, str]:
    """Return the texts of the modules by name, with imports by name, and without a server."""
    texts = {file.name: file.read_text(encoding="utf-8") for file in sorted(STATIC.glob("*.js"))}
    texts["net.js"] = texts.pop("offline.js")
    return {name: re.sub(r'from "\./', f'from "{_PREFIX}', text) for name, text in texts.items()}


def _address(text: str) -> str:
    return f"data:text/javascript;base64,{base64.b64encode(text.encode()).decode()}"


def _digest(text: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"
