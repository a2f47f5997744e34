"""The report: a page that holds all it shows, whatever the data are called."""

import base64
import json
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from needleplan.diagnosis import Library, Verdict, diagnose
from needleplan.models import ModelFile
from needleplan.models.effects import effect_named
from needleplan.reports.diagnosis import next_trials_of, write_folder
from needleplan.signals import Record, Role
from tests.diagnosis.trials import BASE, recordings

FEW = Library([effect_named(name) for name in ("puncture", "viscous", "bias")], BASE)
PUNCTURE = {"puncture": {"size": 0.3, "depth_mm": 33.3, "bulge_mm": 2.5}}
VOID = {"meta", "img", "br", "hr", "link"}
SVG = "data:image/svg+xml;base64,"


class Page(HTMLParser):
    """Tags with their attributes, text, and whether everything is closed as it was opened."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.texts: list[str] = []
        self.open: list[str] = []
        self.feed(text)
        self.close()
        assert not self.open

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.texts.append(data)

    def all(self, tag: str) -> list[dict[str, str | None]]:
        return [attributes for name, attributes in self.tags if name == tag]


def rippled(record: Record) -> Record:
    """What the library does not have: a force that repeats every 3.7 mm."""
    if record.role is Role.NOISE:
        return record
    more = 0.04 * np.sin(2 * np.pi * np.maximum(record["depth_mm"], 0) / 3.7)
    return replace(record, columns={**record.columns, "force_n": record["force_n"] + more})


CASES: dict[str, tuple[list[Record], Verdict]] = {
    "puncture": (recordings(PUNCTURE), Verdict.NAMED),
    "nothing": (recordings(), Verdict.NONE),
    "unknown": ([rippled(each) for each in recordings(seed=4)], Verdict.UNKNOWN),
}


def diagnosed(name: str, place: Path) -> Path:
    """Return the folder of a diagnosis, of trials with a name that would break a page."""
    given, verdict = CASES[name]
    found = diagnose(BASE, [replace(each, trial=f"<script>{each.trial}</script>") for each in given], library=FEW)
    assert found.verdict is verdict
    write_folder(found, ModelFile(BASE), FEW, str(place / "out"), next_=next_trials_of(found))
    return place / "out"


def page_of(folder: Path) -> Page:
    return Page((folder / "report.html").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return diagnosed("puncture", tmp_path_factory.mktemp("diagnosis"))


@pytest.fixture(scope="module")
def page(folder: Path) -> Page:
    return page_of(folder)


@pytest.mark.slow
def test_nothing_is_fetched_and_nothing_runs(page: Page) -> None:
    assert not {"script", "link", "iframe", "object", "form"} & {tag for tag, _ in page.tags}
    for _, attributes in page.tags:
        for name in ("src", "href", "srcset", "action", "background"):
            assert (attributes.get(name) or SVG).startswith(SVG)
        assert not any(name.startswith("on") for name in attributes)
    assert "default-src 'none'" in str([each.get("content") for each in page.all("meta")])
    assert not any("url(" in text or "@import" in text for text in page.texts)


def test_it_can_be_heard(page: Page) -> None:
    assert page.all("html")[0]["lang"] == "en"
    assert len(page.all("h1")) == 1
    assert len(page.all("title")) == 1
    images = page.all("img")
    assert len(images) >= 7
    alternatives = [each["alt"] or "" for each in images]
    assert all(len(text) > 30 for text in alternatives)
    assert len(set(alternatives)) == len(alternatives)
    tables = page.all("table")
    assert len(tables) == len(page.all("caption"))
    assert all(each.get("scope") in ("col", "row") for each in page.all("th"))


def test_the_figures_are_whole(page: Page) -> None:
    for each in page.all("img"):
        root = ElementTree.fromstring(base64.b64decode(str(each["src"]).removeprefix(SVG)))
        names = {element.tag.rpartition("}")[2] for element in root.iter()}
        assert "path" in names
        assert not {"script", "foreignObject"} & names
        links = [value for element in root.iter() for key, value in element.attrib.items() if key.endswith("href")]
        assert all(value.startswith(("#", "data:")) for value in links)


def test_it_says_what_the_document_says(folder: Path, page: Page) -> None:
    document = json.loads((folder / "diagnosis.json").read_text())
    text = " ".join(page.texts)
    assert f"Answer: {document['verdict'].replace('_', ' ')}." in text
    assert document["digest"] in text
    for each in document["effects"]:
        size = each["parameters"]["size"]
        assert f"Amplitude {size['value']:.3g} {size['unit']} (95 %: {size['low']:.3g} to {size['high']:.3g})" in text
    assert all(each["effect"] in text for each in document["smallest"])
    assert all(f"{each['trial']} (" in text for each in document["trials"])
    for name in ("model.toml", "next_motion.toml", "effect_to_name.py"):
        assert (name in text) == (folder / name).exists(), name
    assert bool(document["described"]) == (folder / "effect_to_name.py").exists()
    assert all(each["because"] in text for each in document["hypotheses"])


@pytest.mark.study
@pytest.mark.parametrize("name", ["nothing", "unknown"])
def test_the_same_holds_of_other_answers(name: str, tmp_path: Path) -> None:
    """One test, because two processes of pytest would diagnose twice what all these tests ask for."""
    folder = diagnosed(name, tmp_path)
    page = page_of(folder)
    for check in (test_nothing_is_fetched_and_nothing_runs, test_it_can_be_heard, test_the_figures_are_whole):
        check(page)
    test_it_says_what_the_document_says(folder, page)
