"""The server of the page: who may use it, and what it answers to right and wrong requests."""

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import needleplan as npl
from needleplan.page._access import MOST_BYTES
from needleplan.page._requests import plain
from tests.page.served import Served, served

ENTRY = {"x_mm": 0.0, "y_mm": 20.0, "heading_deg": 5.0}


@pytest.fixture(scope="module")
def server(small: npl.Scenario, table: npl.PolicyTable) -> Iterator[Served]:
    with served(small, table) as found:
        yield found


def test_the_page_loads_nothing_from_elsewhere(server: Served) -> None:
    found = server.ask("/", X_Needleplan_Token="")
    assert found.status == 200
    assert b"<title>needleplan</title>" in found.body
    policy = found.headers["content-security-policy"]
    assert "default-src 'none'" in policy
    assert "http" not in policy
    assert "unsafe" not in policy


@pytest.mark.parametrize(("document", "main"), [("index.html", "view.js"), ("space.html", "space.js")])
def test_all_modules_are_fetched_at_once(document: str, main: str) -> None:
    static = Path(npl.__file__).parent / "page" / "static"
    needed, waiting = set[str](), {main}
    while waiting:
        needed |= waiting
        texts = [(static / name).read_text() for name in waiting]
        waiting = {name for text in texts for name in re.findall(r'from "\./(\w+\.js)"', text)} - needed
    assert set(re.findall(r"/static/(\w+\.js)", (static / document).read_text())) == needed


@pytest.mark.parametrize(
    ("headers", "status", "kind"),
    [
        ({"X_Needleplan_Token": ""}, 401, "token"),
        ({"X_Needleplan_Token": "guessed"}, 401, "token"),
        ({"Origin": "http://evil.example"}, 403, "foreign"),
        ({"Origin": "null"}, 403, "foreign"),
        ({"Host": "evil.example"}, 403, "foreign"),
        ({"Sec_Fetch_Site": "cross-site"}, 403, "foreign"),
    ],
)
def test_strangers_are_refused(server: Served, headers: dict[str, str], status: int, kind: str) -> None:
    found = server.ask("/api/start", **headers)
    assert (found.status, found.told["kind"]) == (status, kind)
    assert "access-control-allow-origin" not in found.headers


def test_files_outside_of_the_page_are_not_served(server: Served) -> None:
    assert server.ask("/static/../_server.py").status == 404
    assert server.ask("/static/%2e%2e/_server.py").status == 404


def test_the_start_has_the_scenario(server: Served, small: npl.Scenario) -> None:
    found = server.ask("/api/start").told
    assert npl.Scenario.from_toml(small.to_toml()).digest == found["digest"]
    assert found["scenario"]["obstacle"][0]["name"] == "rod"
    assert "four_obstacles" in found["shipped"]


def test_a_plan_has_field_and_path_of_the_table(server: Served, table: npl.PolicyTable) -> None:
    scenario = server.ask("/api/start").told["scenario"]
    found = server.ask("/api/plan", {"tab": "a", "scenario": scenario, "start": ENTRY})
    told = found.told
    pose = npl.Pose.deg(0, 20, 5)
    path = table.path(pose)
    assert (told["plan"], told["draft"], told["reached"]) == (table.scenario.digest, False, path.outcome == "target")
    assert told["length_mm"] == path.length_mm
    assert told["predicted_success"] == table.lookup(path.start).success
    data = found.body[4 + int.from_bytes(found.body[:4], "little") :]
    place = told["arrays"]["success"]
    success = np.frombuffer(data, np.uint16, int(np.prod(place["shape"])), place["offset"]).reshape(place["shape"])
    np.testing.assert_allclose(success / 65535, table.success.max(axis=(2, 3)), atol=1e-5)
    place = told["arrays"]["poses"]
    poses = np.frombuffer(data, np.float32, int(np.prod(place["shape"])), place["offset"]).reshape(place["shape"])
    np.testing.assert_allclose(poses, path.poses, rtol=1e-6)


def test_a_field_for_one_heading(server: Served, table: npl.PolicyTable) -> None:
    found = server.ask("/api/field", {"plan": table.scenario.digest, "heading_deg": -20})
    data = found.body[4 + int.from_bytes(found.body[:4], "little") :]
    place = found.told["arrays"]["success"]
    success = np.frombuffer(data, np.uint16, int(np.prod(place["shape"])), place["offset"]).reshape(place["shape"])
    np.testing.assert_allclose(success / 65535, table.success[:, :, 34].max(axis=2), atol=1e-5)


def test_executions_are_those_of_the_table(server: Served, table: npl.PolicyTable) -> None:
    told = server.ask("/api/executions", {"plan": table.scenario.digest, "start": ENTRY, "runs": 500}).told
    rollouts = table.rollout(npl.Pose.deg(0, 20, 5), 500)
    assert told["success"] == rollouts.success
    assert tuple(told["interval"]) == rollouts.interval


def test_a_target_below_the_grid_is_told(server: Served) -> None:
    scenario = server.ask("/api/start").told["scenario"]
    small = {**scenario, "target": {**scenario["target"], "radius_mm": 0.1}}
    plan = server.ask("/api/plan", {"tab": "c", "scenario": small, "start": ENTRY}).told["plan"]
    told = server.ask("/api/executions", {"plan": plan, "start": ENTRY, "runs": 500}).told
    assert any(warning.startswith("the target is 0.") for warning in told["warnings"])


def test_a_draft_is_coarse_and_says_so(server: Served, small: npl.Scenario) -> None:
    fine = replace(small, grid=replace(small.grid, spacing_mm=(0.25, 0.25)), title="fine")
    raw = {**server.ask("/api/start").told["scenario"], "title": "fine", "grid": {"spacing_mm": [0.25, 0.25]}}
    told = server.ask("/api/plan", {"tab": "b", "scenario": raw, "draft": True, "start": ENTRY}).told
    assert told["draft"]
    assert told["states"] < fine.states
    assert told["states"] <= 1.1 * 1_500_000


@pytest.mark.parametrize(
    ("path", "body", "status", "word"),
    [
        ("/api/plan", b"{", 400, "is not JSON"),
        ("/api/plan", b"[1]", 400, "is not JSON"),
        ("/api/plan", b"\xff" * 10, 400, "is not JSON"),
        ("/api/plan", b"[" * 200_000, 400, "is not JSON"),
        ("/api/plan", {}, 200, "scenario"),
        (
            "/api/plan",
            {"scenario": {"schema": "needleplan.scenario/1", "workspace": {"width_mm": -1}}},
            200,
            "width_mm",
        ),
        ("/api/plan", {"scenario": {"a": {"b": [None]}}}, 200, "TOML"),
        ("/api/path", {"plan": "sha256:0"}, 200, "no such plan"),
        ("/api/field", {"plan": None}, 200, "no such plan"),
    ],
)
def test_wrong_requests_get_a_reason(server: Served, path: str, body: object, status: int, word: str) -> None:
    found = server.ask(path, body)
    assert found.status == status
    assert found.headers["content-type"] == "application/problem+json"
    assert word in found.told["text"]


@pytest.mark.parametrize(
    "more",
    [
        {"start": {"x_mm": -5, "y_mm": 1, "heading_deg": 0}},
        {"start": {"x_mm": "a", "y_mm": 1, "heading_deg": 0}},
        {"start": [0, 0, 0]},
        {"edge": "front"},
        {"heading_deg": "north"},
        {"runs": 0},
        {"runs": 10**9},
    ],
)
def test_wrong_poses_and_numbers_get_a_reason(server: Served, table: npl.PolicyTable, more: dict[str, object]) -> None:
    path = "/api/field" if "heading_deg" in more else "/api/executions"
    found = server.ask(path, {"plan": table.scenario.digest, **more})
    assert (found.status, found.told["kind"]) == (200, "input")


def test_a_huge_upload_is_refused(server: Served) -> None:
    assert server.ask("/api/plan", b" " * (MOST_BYTES + 1)).status == 413
    assert server.ask("/api/start").status == 200


def test_infinite_radii_pass_as_text(server: Served) -> None:
    scenario = npl.Scenario.read("layered")
    layers = [{"from_mm": 10.0, "curvature_radius_mm": "inf"}]
    raw = plain({"schema": "needleplan.scenario/1", **server.ask("/api/start").told["scenario"]})
    raw["needle"] = {"curvature_radius_mm": 40.0, "layer": layers}
    raw["motion"] = {"headings": 36, "step_mm": 4.0}
    assert scenario.needle.layers
    assert server.ask("/api/plan", {"tab": "c", "scenario": raw, "start": ENTRY}).status == 200
