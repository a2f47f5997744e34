"""Measure how long a user of `needleplan view` waits: from a drag to the painted path, and to the first path.

python benches/python/view_latency.py --json view.json > view.md

A browser drags a handle in a circle, 40 moves a second, of a plan with 1.18 million states. The page notes the time
from a move to the frame that first shows its path; moves that a newer one has replaced are not painted and not counted.
"""

import argparse
import json
import math
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import machine
import numpy as np
from playwright.sync_api import Browser, Page, sync_playwright

GOALS_MS = (100.0, 200.0)
GOAL_FIRST_MS = 1000.0
GOAL_FRAMES_PER_S = 60.0
MOVES = 200
MOVES_PER_S = 40
REACH_PIXELS = 15
HANDLES = {
    "entry": "entry (path only)",
    "heading": "heading (path only)",
    "target": "target (solve and path)",
    "polygon_mm 1 0": "corner of an obstacle (solve and path)",
    "body 2": "obstacle (solve and path)",
}
DONE = "body[data-state=done]"


def main() -> int:
    """Run all measurements and print a table. Returns exit code 1 if a goal is missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    about = machine.description()
    command = [sys.executable, "-m", "needleplan", "view", "four_obstacles", "--no-browser", "--port", "0", "--quiet"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server, sync_playwright() as playwright:
        try:
            address = server.stdout.readline().strip() if server.stdout else ""
            browser = playwright.chromium.launch(
                executable_path=shutil.which("chromium"), args=["--no-sandbox"] if os.geteuid() == 0 else []
            )
            figures = measured(browser, address)
            frames = frame_gaps(browser, address)
            browser.close()
        finally:
            server.terminate()
    met = report(figures, frames, about)
    if options.json:
        record = {
            "machine": about,
            "goals_ms": GOALS_MS,
            "figures_ms": {key: list(each) for key, each in figures.items()},
            "frame_gaps_ms": list(frames),
        }
        options.json.write_text(json.dumps(record) + "\n", encoding="utf-8")
    return int(not met)


def measured(browser: Browser, address: str) -> dict[str, np.ndarray]:
    """Return the waits in ms by name."""
    firsts = []
    for _ in range(10):
        page = browser.new_page(viewport={"width": 1280, "height": 800})
        page.goto(address)
        page.wait_for_selector(DONE)
        firsts.append(waits(page, from_start=True)[0])
        page.close()
    figures = {"first path": np.array(firsts)}
    page = browser.new_page(viewport={"width": 1280, "height": 800})
    page.goto(address)
    page.wait_for_selector(DONE)
    for key, name in HANDLES.items():
        page.evaluate("performance.clearMeasures()")
        drag_around(page, key)
        page.wait_for_selector(DONE)
        figures[name] = waits(page)
        page.get_by_role("button", name="Undo").click()
        page.wait_for_selector(DONE)
    return figures


def frame_gaps(browser: Browser, address: str) -> np.ndarray:
    """Return the times (ms) between the frames while the executions are played."""
    page = browser.new_page(viewport={"width": 1280, "height": 800})
    page.goto(address)
    page.wait_for_selector(DONE)
    button = page.get_by_role("button", name="Play the executions")
    button.click()
    page.get_by_role("button", name="Show all of the executions").wait_for()
    button.wait_for()
    times = np.array(page.evaluate("performance.getEntriesByName('frame of executions').map(each => each.startTime)"))
    page.close()
    return np.diff(times)


def drag_around(page: Page, key: str) -> None:
    """Drag a handle along a small circle, at a constant rate."""
    box = page.locator(f'[data-key="{key}"]').bounding_box()
    assert box
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    began = time.perf_counter()
    for number in range(1, MOVES + 1):
        angle = 2 * math.pi * number / MOVES_PER_S / 1.5
        page.mouse.move(x + REACH_PIXELS * math.sin(angle), y + REACH_PIXELS * (1 - math.cos(angle)))
        time.sleep(max(began + number / MOVES_PER_S - time.perf_counter(), 0))
    page.mouse.up()


def waits(page: Page, *, from_start: bool = False) -> np.ndarray:
    """Return the waits that the page has noted, in ms; with `from_start`, the ends since the navigation began."""
    key = "each.startTime + each.duration" if from_start else "each.duration"
    return np.array(page.evaluate(f"performance.getEntriesByName('change to path').map(each => {key})"))


def report(figures: dict[str, np.ndarray], frames: np.ndarray, about: dict[str, object]) -> bool:
    """Print the table, and return whether all goals are met."""
    print(f"{about['date']}, commit {about['commit']}, {about['processor']}, {about['threads']} threads.")
    print(
        f"Load average before the run {about['load_before']}: above 0.5, other programs have computed at the same time."
    )
    print(f"Priority of the run: {about['priority']}.\n")
    print(
        "Four obstacles, 1,176,120 states while dragging; 1280 x 800 pixels, drawn without a graphics processor; ms.\n"
    )
    print("| | painted | median | 95 % | largest |\n|---|--:|--:|--:|--:|")
    met = True
    for name, each in figures.items():
        median, high = np.percentile(each, [50, 95])
        print(f"| {name} | {len(each)} | {median:.0f} | {high:.0f} | {each.max():.0f} |")
        goals = (GOAL_FIRST_MS, math.inf) if name == "first path" else GOALS_MS
        met &= bool(median < goals[0] and high < goals[1])
    rate = 1000 / frames.mean()
    median, high = np.percentile(frames, [50, 95])
    print(f"\nExecutions played: {rate:.0f} frames a second (goal {GOAL_FRAMES_PER_S:g}); "
          f"gaps in ms: median {median:.1f}, 95 % {high:.1f}, largest {frames.max():.1f}.")  # fmt: skip
    print(f"\nGoals: median below {GOALS_MS[0]:g}, 95 % below {GOALS_MS[1]:g}, first path below {GOAL_FIRST_MS:g} ms: "
          f"{'met' if met else 'missed'}")  # fmt: skip
    return met


if __name__ == "__main__":
    sys.exit(main())
