"""Shows the figures of a scene of the gallery that pyplot does not know, such as those that `draw_entries` returns."""

from typing import Any

from matplotlib.figure import Figure
from sphinx_gallery.scrapers import figure_rst


def scrape(_block: Any, block_vars: dict[str, Any], gallery_conf: dict[str, Any]) -> str:
    """Save the figures among the names of a scene and return the text that shows them."""
    names = block_vars["example_globals"]
    files = []
    for each in [value for value in names.values() if isinstance(value, Figure) and value.canvas.manager is None]:
        file = next(block_vars["image_path_iterator"])
        each.savefig(file, dpi=100)
        files.append(file)
    return figure_rst(files, gallery_conf["src_dir"])


def _get_sg_image_scraper() -> Any:
    """Return the function that Sphinx-Gallery calls after each block of a scene."""
    return scrape
