"""Builds the documentation site; warnings are errors, and every internal link must lead somewhere.

Usage: python docs/site/build.py [FOLDER [OPTION...]]. The pages are in FOLDER/html (out/site/html). Options are those
of sphinx-build; `-D plot_gallery=0` leaves the scenes of the gallery unrun, and the build takes half a minute.
"""

import shutil
import sys
from pathlib import Path

from sphinx.cmd.build import build_main

import links
import stage


def build(folder: Path, *options: str) -> int:
    """Stage the sources, run Sphinx, check the links; return the exit code."""
    source, pages = folder / "source", folder / "html"
    for each in (source, pages):
        shutil.rmtree(each, ignore_errors=True)
    source.mkdir(parents=True)
    stage.stage(source)
    strict = ["--fail-on-warning", "--keep-going", "--quiet", "--doctree-dir", str(folder / "doctrees")]
    code = build_main(["--builder", "html", "--conf-dir", str(stage.DOCS), *strict, *options, str(source), str(pages)])
    broken = links.broken(pages)
    for link in broken:
        print(f"broken link: {link}", file=sys.stderr)
    return code or int(bool(broken))


if __name__ == "__main__":
    where, *further = [*sys.argv[1:], *(["out/site"] if len(sys.argv) == 1 else [])]
    sys.exit(build(Path(where), *further))
