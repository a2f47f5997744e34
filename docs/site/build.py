"""Builds the documentation site; warnings are errors, and every internal link must lead somewhere.

Usage: python docs/site/build.py [--quick] [FOLDER]. The pages are in FOLDER/html (out/site/html). With `--quick` the
scenes of the gallery and the notebooks are not run, and the build takes half a minute.
"""

import argparse
import shutil
import sys
from pathlib import Path

from sphinx.cmd.build import build_main

import links
import stage


def build(folder: Path, *, quick: bool) -> int:
    """Stage the sources, run Sphinx, check the links; return the exit code."""
    source, pages = folder / "source", folder / "html"
    for each in (source, pages):
        shutil.rmtree(each, ignore_errors=True)
    source.mkdir(parents=True)
    stage.stage(source, quick=quick)
    options = ["--fail-on-warning", "--keep-going", "--quiet", "--doctree-dir", str(folder / "doctrees")]
    options += ["--define", "plot_gallery=0"] if quick else []
    code = build_main(["--builder", "html", "--conf-dir", str(stage.DOCS), *options, str(source), str(pages)])
    broken = links.broken(pages)
    for link in broken:
        print(f"broken link: {link}", file=sys.stderr)
    return code or int(bool(broken))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("folder", type=Path, nargs="?", default=Path("out/site"))
    given = parser.parse_args()
    sys.exit(build(given.folder, quick=given.quick))
