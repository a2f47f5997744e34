"""What is installed, and what this machine can do: `needleplan.show_versions` and `needleplan doctor`."""

from __future__ import annotations

import os
import platform
import shutil
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from needleplan.extras import EXTRAS, is_installed

__all__ = ["Check", "checks", "show_versions", "versions"]

# Libraries of every installation, by the name of the package.
_REQUIRED = ("numpy", "h5py", "shapely")
# Packages whose name differs from that of their import.
_PACKAGES = {"nrrd": "pynrrd"}
# Browsers that can show the page of `needleplan view`; those of the Chromium family also tell what they can draw.
_BROWSERS = ("google-chrome", "chromium", "chromium-browser", "firefox")
# Page that says whether the browser has the interface with which the page of `needleplan view` draws in 3D.
_WEBGL_PAGE = "data:text/html,<script>document.write(!!document.createElement('canvas').getContext('webgl2'))</script>"
_BROWSER_S = 30.0  # longest time (s) that a browser takes to draw a page, also on a loaded machine
# Free space (bytes) that a 3D table of 100 million states needs.
_TABLE_BYTES = 7e8


@dataclass(frozen=True)
class Check:
    """One answer of `needleplan doctor`: what was looked at, what was found, and what to do if it is not `good`."""

    name: str
    good: bool
    found: str
    remedy: str = ""
    is_required: bool = False


def versions() -> dict[str, str]:
    """Return the versions of Python, needleplan and its libraries; "" for an optional library that is missing."""
    found = {"python": platform.python_version(), "platform": platform.platform(), "needleplan": version("needleplan")}
    for library in (*_REQUIRED, *EXTRAS):
        try:
            found[library] = version(_PACKAGES.get(library, library))
        except PackageNotFoundError:
            found[library] = ""
    return found


def show_versions() -> None:
    """Print the versions of Python, needleplan and its libraries, for the report of an error.

    Examples
    --------
    >>> import needleplan as npl
    >>> npl.show_versions()  # doctest: +ELLIPSIS
    python        3...
    """
    found = versions()
    width = max(map(len, found))
    for name, number in found.items():
        print(f"{name:<{width}} {number or '(not installed)'}")


def checks(folder: str | os.PathLike[str] = ".") -> Iterator[Check]:
    """Yield the checks of the installation that `needleplan doctor` prints, with the free disk space of `folder`."""
    yield _solver()
    cargo = shutil.which("cargo")
    yield Check("Rust", True, cargo or "not installed; only needed to build from source")
    missing: dict[str, list[str]] = {}
    for library, extra in EXTRAS.items():
        missing.setdefault(extra, []).extend([] if is_installed(library) else [library])
    for extra, libraries in missing.items():
        found = f"without {', '.join(libraries)}" if libraries else "installed"
        remedy = f'pip install "needleplan[{extra}]"' if libraries else ""
        yield Check(f"extra {extra}", not libraries, found, remedy)
    yield _real_time()
    yield _ports()
    browser = next(filter(None, map(shutil.which, _BROWSERS)), "")
    yield Check("browser", bool(browser), browser or "none found", "" if browser else "install Chromium or Firefox")
    if "chrom" in browser:
        yield _rendering(browser)
    yield _disk(Path(folder))


def _solver() -> Check:
    try:
        import_module("needleplan.planning")
    except ImportError as error:
        remedy = "install the package again; to build it from source, install Rust (https://rustup.rs)"
        return Check("compiled solver", False, str(error), remedy, is_required=True)
    return Check("compiled solver", True, f"{os.cpu_count()} processors, {platform.machine()}", is_required=True)


def _real_time() -> Check:
    """Return whether processes of this user may ask for real-time scheduling, which a loaded machine needs."""
    if not hasattr(os, "sched_setscheduler"):
        return Check("real time", False, f"{sys.platform} has no FIFO scheduling", "drive robots from Linux")
    before = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
        os.sched_setscheduler(0, *before)
    except OSError:
        remedy = "allow rtprio in /etc/security/limits.conf, or run under `chrt --fifo 50`"
        return Check("real time", False, "FIFO scheduling is not allowed", remedy)
    return Check("real time", True, "FIFO scheduling is allowed")


def _ports() -> Check:
    """Return whether programs may exchange datagrams on this machine, as `lab` and `insert` do."""
    try:
        with (
            socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver,
            socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender,
        ):
            receiver.bind(("127.0.0.1", 0))
            receiver.settimeout(1.0)
            sender.sendto(b"needleplan", receiver.getsockname())
            receiver.recv(16)
    except OSError as error:
        return Check("ports", False, f"no datagram arrived on 127.0.0.1: {error}", "allow UDP on 127.0.0.1")
    return Check("ports", True, "UDP on 127.0.0.1 works")


def _rendering(browser: str) -> Check:
    """Return whether a browser of the Chromium family draws 3D scenes without a graphics card."""
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        # Chromium has no sandbox for root, as whom containers run.
        root = ["--no-sandbox"] if getattr(os, "geteuid", lambda: 1)() == 0 else []
        options = ["--headless", "--disable-gpu", "--no-first-run", f"--user-data-dir={profile}", *root]
        try:
            done = subprocess.run(
                [browser, *options, "--dump-dom", _WEBGL_PAGE],
                stdin=subprocess.DEVNULL, capture_output=True, timeout=_BROWSER_S, check=False,
            )  # fmt: skip
            drawn = b"true</body>" in done.stdout
        except (OSError, subprocess.TimeoutExpired):
            drawn = False
    if drawn:
        return Check("rendering", True, "the browser draws in 3D without a graphics card")
    rule = "allow WebGL by software: start it with --enable-unsafe-swiftshader, or use another browser"
    return Check("rendering", False, "the browser has no WebGL without a graphics card", rule)


def _disk(folder: Path) -> Check:
    free = shutil.disk_usage(folder).free
    enough = free >= _TABLE_BYTES
    remedy = "" if enough else f"a 3D table of 100 million states needs {_TABLE_BYTES / 1e9:.1f} GB"
    return Check("disk", enough, f"{free / 1e9:.1f} GB free in {folder.resolve()}", remedy)
