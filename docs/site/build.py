"""Builds the documentation site; warnings are errors, and every internal link must lead somewhere.

Usage: python docs/site/build.py [FOLDER]. The pages are in FOLDER/html (out/site/html).
"""

import shutil
import sys
from pathlib import Path

from sphinx.cmd.build import build_main

import links
import stage


def build(folder: Path) -> int:
    """Stage the sources, run Sphinx, check the links; return the exit code."""
    source, pages = folder / "source", folder / "html"
    for each in (source, pages):
        shutil.rmtree(each, ignore_errors=True)
    source.mkdir(parents=True)
    stage.stage(source)
    options = ["--fail-on-warning", "--keep-going", "--quiet", "--doctree-dir", str(folder / "doctrees")]
    code = build_main(["--builder", "html", "--conf-dir", str(stage.DOCS), *options, str(source), str(pages)])
    broken = links.broken(pages)
    for link in broken:
        print(f"broken link: {link}", file=sys.stderr)
    return code or int(bool(broken))


if __name__ == "__main__":
    sys.exit(build(Path(sys.argv[1] if len(sys.argv) > 1 else "out/site")))
