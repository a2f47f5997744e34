"""Machine, software versions and commit of a measurement."""

import os
import platform
import subprocess
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = (
    "needleplan",
    "numpy",
    "numba",
    "quantecon",
    "mdpsolver",
    "pymdptoolbox",
    "stormpy",
    "ompl",
)


def description() -> dict[str, object]:
    """Return the machine, the software versions, the commit and the date of this run."""
    return {
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "commit": commit(),
        "processor": processor(),
        "threads": os.cpu_count(),
        "load_before": round(os.getloadavg()[0], 2),
        "priority": priority(),
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        "rustc": said("rustc", "--version"),
        "packages": {name: version for name in PACKAGES if (version := _version(name))},
    }


def commit() -> str:
    """Return the abbreviated commit, followed by a plus if tracked files differ from it."""
    dirty = "+" if said("git", "status", "--porcelain", "--untracked-files=no") else ""
    return (said("git", "rev-parse", "--short=10", "HEAD") or "unknown") + dirty


def priority() -> str:
    """Return the scheduling policy and priority of this process, which its child processes inherit."""
    policies = {os.SCHED_FIFO: "real-time, SCHED_FIFO", os.SCHED_RR: "real-time, SCHED_RR"}
    policy = policies.get(os.sched_getscheduler(0))
    return f"{policy} {os.sched_getparam(0).sched_priority}" if policy else f"normal, nice {os.nice(0)}"


def processor() -> str:
    """Return the name of the processor."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="ascii", errors="replace").splitlines()
    except OSError:
        return platform.processor() or "unknown"
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else "unknown"


def said(*command: str) -> str:
    """Run a command in the repository; return its output, or an empty text if it fails."""
    try:
        return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return ""


def _version(package: str) -> str:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return ""
