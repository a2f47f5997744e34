"""`needleplan doctor` and `show_versions` say what is there and what is not."""

from __future__ import annotations

import json
import sys

import pytest

import needleplan as npl
from needleplan.extras import EXTRAS, installed
from tests.cli.commands import needleplan


def test_every_extra_and_what_a_plan_needs_is_checked() -> None:
    done = needleplan("doctor", "--json")
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    found = {each["name"]: each for each in told["checks"]}
    assert {f"extra {extra}" for extra in EXTRAS.values()} <= set(found)
    assert found["compiled solver"]["good"]
    assert found["ports"]["good"]
    assert told["versions"]["numpy"] == __import__("numpy").__version__
    lines = needleplan("doctor").stdout.splitlines()
    assert lines[0].startswith(f"needleplan {npl.__version__}, Python {sys.version.split()[0]}")


def test_what_is_missing_is_named_with_its_remedy(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from needleplan.cli import main

    monkeypatch.setitem(sys.modules, "xarray", None)
    monkeypatch.setattr(installed, "import_module", lambda name: (_ for _ in ()).throw(ImportError(f"no {name}")))
    assert main(["doctor"]) == 1
    told = capsys.readouterr().out
    assert "--  extra xarray     without xarray\n" in told
    assert 'pip install "needleplan[xarray]"' in told
    assert "--  compiled solver  no needleplan.planning" in told


def test_show_versions_names_every_library(capsys: pytest.CaptureFixture[str]) -> None:
    npl.show_versions()
    lines = dict(line.split(None, 1) for line in capsys.readouterr().out.splitlines())
    assert lines["needleplan"] == npl.__version__
    assert set(EXTRAS) < set(lines)
