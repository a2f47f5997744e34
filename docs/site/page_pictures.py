"""Takes the pictures of the interactive page for the documentation.

Usage: python docs/site/page_pictures.py docs/images

Needs playwright and chromium, as the tests in `tests/browser` do.
"""

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from playwright.sync_api import Browser, sync_playwright

from needleplan.cli import main
from needleplan.models import ModelFile, ShaftAndTip, simulate
from needleplan.models.effects import effect_named
from needleplan.recording import write_records
from needleplan.signals import Record, Role, lspb

_SIZE = {"width": 1280, "height": 800}
_LONGEST_MS = 120_000
# Motions of the recordings of the diagnosis: role, depths (mm), speeds (mm/s).
_MOTIONS = {
    "first": (Role.TRAIN, [-2, 30, 20, 60, -2], [4, 8, 6, 12]),
    "second": (Role.TRAIN, [-2, 45, 35, 60, -2], [9, 5, 3, 10]),
    "third": (Role.HOLDOUT, [-2, 20, 60, -2], [10, 4, 8]),
}


def diagnosed(folder: Path) -> Path:
    """Return the folder of a diagnosis: the needle punctures a membrane, which the model lacks."""
    base = ShaftAndTip(friction=0.012, cutting=0.4, onset_mm=4.0, presliding_mm=0.05)
    needle = effect_named("puncture").apply(base, {"size": 0.3, "depth_mm": 33.3, "bulge_mm": 2.5})
    random = np.random.default_rng(0)
    still = {"time_s": np.arange(1500) / 50, "force_n": random.normal(0, 0.02, 1500)}
    records = [Record(still, "air", Role.NOISE)]
    for name, (role, depths, speeds) in _MOTIONS.items():
        motion = lspb(depths, speeds, rate_hz=50)
        force = simulate(needle, motion).output + random.normal(0, 0.02, len(motion))
        columns = {"time_s": motion.time_s, "depth_mm": motion.depth_mm, "velocity_mm_s": motion.velocity_mm_s}
        records.append(Record({**columns, "force_n": force}, name, role))
    ModelFile(base).write(folder / "model.toml")
    write_records(records, folder / "data.csv")
    main(["diagnose", str(folder / "model.toml"), str(folder / "data.csv"), "-o", str(folder / "found"), "--quiet"])
    return folder / "found"


def take(browser: Browser, opened: str, picture: Path) -> None:
    """Serve the page of a file, and take a picture of it once everything is there."""
    command = [sys.executable, "-m", "needleplan", "view", opened, "--no-browser", "--port", "0", "--quiet"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
        try:
            page = browser.new_page(viewport=_SIZE)
            page.goto(server.stdout.readline().strip())
            page.wait_for_selector('body[data-state="done"]', timeout=_LONGEST_MS)
            page.wait_for_selector('[aria-busy="true"]', state="detached", timeout=_LONGEST_MS)  # estimated in 3D
            page.screenshot(path=picture)
            page.close()
        finally:
            server.terminate()


def take_all(target: Path) -> None:
    """Take the pictures of a plan, of a 3D plan, and of a diagnosis."""
    chromium = shutil.which("chromium") or shutil.which("google-chrome")
    with tempfile.TemporaryDirectory() as place, sync_playwright() as playwright:
        folder = Path(place)
        main(["new", str(folder / "phantom"), "--anatomy", "liver", "--seed", "3", "--quiet"])
        browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        take(browser, "four_obstacles", target / "view.png")
        take(browser, str(folder / "phantom" / "anatomy.toml"), target / "view_space.png")
        take(browser, str(diagnosed(folder)), target / "view_diagnosis.png")


if __name__ == "__main__":
    take_all(Path(sys.argv[1]))
