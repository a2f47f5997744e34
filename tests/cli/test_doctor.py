"""`needleplan doctor` and `show_versions` say what is there and what is not."""

import json
import shutil
import sys
from pathlib import Path

import pytest

import needleplan as npl
from needleplan.cli import main
from needleplan.extras import EXTRAS, installed
from tests.cli.commands import needleplan


@pytest.fixture(autouse=True)
def without_browser(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """A browser takes seconds to start."""
    if "slow" not in request.keywords:
        monkeypatch.setattr(installed, "_BROWSERS", ())


def test_every_extra_and_what_a_plan_needs_is_checked(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["doctor", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    found = {each["name"]: each for each in told["checks"]}
    assert {f"extra {extra}" for extra in EXTRAS.values()} <= set(found)
    assert found["compiled solver"]["good"]
    assert found["ports"]["good"]
    assert told["versions"]["numpy"] == __import__("numpy").__version__


def test_what_is_missing_is_named_with_its_remedy(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "xarray", None)
    monkeypatch.setattr(installed, "import_module", lambda name: (_ for _ in ()).throw(ImportError(f"no {name}")))
    assert main(["doctor"]) == 1
    told = capsys.readouterr().out
    assert told.startswith(f"needleplan {npl.__version__}, Python {sys.version.split()[0]}")
    assert "--  browser          none found\n" in told
    assert "--  extra xarray     without xarray\n" in told
    assert 'pip install "needleplan[xarray]"' in told
    assert "--  compiled solver  no needleplan.planning" in told


@pytest.mark.slow
@pytest.mark.skipif(not any(map(shutil.which, ("chromium", "google-chrome"))), reason="chromium is not installed")
def test_a_browser_draws_without_a_graphics_card() -> None:
    done = needleplan("doctor")
    assert done.returncode == 0, done.stderr
    assert "ok  rendering        the browser draws in 3D without a graphics card\n" in done.stdout


def test_a_browser_that_cannot_draw_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    browser = tmp_path / "chromium"
    browser.write_text("#!/bin/sh\necho '<html><body>false</body></html>'\n")
    browser.chmod(0o755)
    monkeypatch.setattr(installed, "_BROWSERS", (str(browser),))
    found = {each.name: each for each in installed.checks()}
    assert found["browser"].good
    assert not found["rendering"].good
    assert "--enable-unsafe-swiftshader" in found["rendering"].remedy


def test_show_versions_names_every_library(capsys: pytest.CaptureFixture[str]) -> None:
    npl.show_versions()
    told = capsys.readouterr().out.splitlines()
    lines = dict(line.split(None, 1) for line in told)
    assert len({line.index(number) for line, number in zip(told, lines.values(), strict=True)}) == 1
    assert lines["needleplan"] == npl.__version__
    assert set(EXTRAS) < set(lines)
