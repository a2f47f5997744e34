"""Sphinx configuration of the documentation site; `make docs` builds it (see site/build.py)."""

import sys
from pathlib import Path

from needleplan.artifacts import version as needleplan_version

sys.path.insert(0, str(Path(__file__).parent / "site"))  # extensions of our own

project = "needleplan"
author = "The needleplan authors"
version = release = needleplan_version()

extensions = [
    "myst_nb",
    "numpydoc",
    "sphinx.ext.autodoc",
    "sphinx_gallery.gen_gallery",
    "docstrings",
    "lexers",
    "mathml",
]
root_doc = "index"
default_role = "code"  # `name` in a docstring is code, as in Markdown

myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 4  # deepest level of heading that a link may name, as on GitHub

# Types stand in the numpydoc sections, in words; signatures with annotations would name private modules.
autodoc_typehints = "none"
autodoc_member_order = "bysource"
numpydoc_show_class_members = False

sphinx_gallery_conf = {
    "examples_dirs": "scenes",
    "gallery_dirs": "gallery",
    "filename_pattern": r"\.py$",  # run every scene
    "image_scrapers": ("matplotlib", "figures"),
    "nested_sections": True,
    "subsection_order": [f"scenes/{each}" for each in ("plane", "space", "sweep", "mechanics", "recordings", "lab")],
    "within_subsection_order": "FileNameSortKey",
    "download_all_examples": False,
    "show_signature": False,
    "write_computation_times": False,
    "min_reported_time": 1e9,  # seconds; times differ from build to build
    "copyfile_regex": r"",
}
exclude_patterns = ["scenes", "gallery/**/*.ipynb"]  # Sphinx-Gallery makes pages from scenes, and downloads
nb_execution_mode = "off"  # notebooks.py has run them

html_theme = "pydata_sphinx_theme"
html_title = "needleplan"
html_static_path = ["site/static"]
html_js_files = [("sortable.js", {"defer": "defer"})]
html_css_files = ["wide.css"]
html_show_sourcelink = False
html_copy_source = False
html_math_renderer = "mathml"
html_theme_options = {
    "github_url": "https://github.com/needleplan/needleplan",
    "header_links_before_dropdown": 10,
    "show_toc_level": 2,
    "secondary_sidebar_items": {"validation/*": []},
    "footer_start": ["copyright"],
    "footer_end": [],
}
html_context = {"default_mode": "auto"}
copyright = "the needleplan authors. Research software, not a medical device"
