"""Each page loads its modules at once: those that its main module needs, and no others."""

import re

import pytest

from needleplan.page._requests import STATIC


def needed(module: str) -> set[str]:
    """Return the modules that a module imports, directly or by way of others, and the module itself."""
    found, left = set[str](), [module]
    while left:
        name = left.pop()
        if name not in found:
            found.add(name)
            left += re.findall(r'^import .* from "\./(\w+\.js)";$', (STATIC / name).read_text(), re.MULTILINE)
    return found


@pytest.mark.parametrize("document", ["index.html", "space.html", "diagnosis.html"])
def test_a_page_names_the_modules_that_it_needs(document: str) -> None:
    text = (STATIC / document).read_text()
    (main,) = re.findall(r'<script type="module" src="/static/(\w+\.js)">', text)
    early = re.findall(r'<link rel="modulepreload" href="/static/(\w+\.js)">', text)
    assert early == sorted(early)
    assert {*early, main} == needed(main)


def test_every_module_belongs_to_a_page() -> None:
    used = set().union(*(needed(main) for main in ("view.js", "space.js", "diagnosis.js")))
    assert {file.name for file in STATIC.glob("*.js")} == used | {"offline.js"}
