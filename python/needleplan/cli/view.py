"""`needleplan view`: serve the interactive page on this machine."""

from __future__ import annotations

import argparse
import secrets
import threading
import webbrowser
from pathlib import Path
from typing import TYPE_CHECKING, Any

from needleplan.cli.answer import note, working
from needleplan.cli.interrupt import handled_signals
from needleplan.cli.options import add_start, add_verify_key, read_table, require_outputs, start_pose
from needleplan.cli.parser import whole
from needleplan.errors import InputError, Mistake, ScenarioError
from needleplan.extras import require

if TYPE_CHECKING:
    from needleplan.page import Opened

__all__ = ["add_to"]

# Port that is used if it is free. The browser keeps unsaved edits by port, so it should be the same each time.
_USUAL_PORT = 8417

# Endings of files that are policy tables.
_TABLE_ENDINGS = (".h5", ".hdf5")


def add_to(commands: Any) -> None:
    """Declare the command."""
    parser: argparse.ArgumentParser = commands.add_parser(
        "view",
        help="see and change a plan in the browser",
        description="Serve a page on this machine that shows a plan and plans again while you drag entry, target and "
        "obstacles. Print its address, open it in the browser, and serve it until Ctrl-C. "
        "Needs `pip install needleplan[view]`, unless with --export.",
    )
    parser.add_argument(
        "file", metavar="FILE", nargs="?", default="four_obstacles",
        help="a scenario (.toml), the name of a shipped scenario, a policy table (.h5), or a recording of an insertion "
        "(.mcap) (four_obstacles)",
    )  # fmt: skip
    add_verify_key(parser)
    add_start(parser)
    parser.add_argument(
        "--export", metavar="FILE.html", help="write the page of the plan into one file, and serve nothing"
    )
    parser.add_argument("--force", dest="overwrite", action="store_true", help="overwrite a file that exists")
    parser.add_argument("--port", type=whole, metavar="N", help=f"port to serve on ({_USUAL_PORT}, or a free one)")
    parser.add_argument("--no-browser", action="store_true", help="print the address only")
    parser.add_argument("-q", "--quiet", action="store_true", help="print no remarks; errors are still printed")
    parser.set_defaults(run=_run, overwrite_option="--force")


def _run(options: argparse.Namespace) -> int:
    """Serve the page until a signal ends it, and return the exit code 0. Raises InputError."""
    if options.port is not None and not 0 <= options.port <= 65535:
        raise InputError(Mistake("--port", f"{options.port}", "must be a port, from 0 to 65535; 0 is any free one"))
    if not options.export:
        require("starlette", "uvicorn")
    opened = _opened(options)
    if options.export:
        return _export(opened, options)
    from needleplan.page import HOST, Page, bind, make_server

    with bind(options.port, _USUAL_PORT) as listening:
        port, token = listening.getsockname()[1], secrets.token_urlsafe(24)
        page = Page(opened)
        server = make_server(page, token, port)
        ended = threading.Event()

        def run_server() -> None:
            try:
                server.run(sockets=[listening])
            finally:
                ended.set()

        thread = threading.Thread(target=run_server, name="needleplan page")
        with handled_signals(lambda _: ended.set()):
            thread.start()
            address = f"http://{HOST}:{port}/#token={token}"
            print(address, flush=True)
            note("the address holds a secret: keep it to yourself; Ctrl-C ends the page")
            if not options.no_browser:
                webbrowser.open(address)
            ended.wait()
            server.should_exit = True
            page.queue.close()
            thread.join()
    return 0


def _export(opened: Opened, options: argparse.Namespace) -> int:
    """Write the page of the plan into one file and return the exit code 0. Raises InputError."""
    from needleplan.artifacts import write_whole
    from needleplan.page import Page

    require_outputs(options, [options.file], options.export)
    page = Page(opened)
    with working(options, "solving and executing"):
        content = page.page(page.start())
    page.queue.close()
    write_whole(options.export, content)
    note(f"wrote {options.export}, {len(content) / 1e6:.1f} MB; open it in a browser")
    return 0


def _opened(options: argparse.Namespace) -> Opened:
    """Return the scenario or table that the options name. Raises InputError if it is wrong."""
    from needleplan.page import Opened
    from needleplan.planning import Pose
    from needleplan.scenario import Scenario

    start = Pose.of(start_pose(options.start)) if options.start is not None else None
    if Path(options.file).suffix.lower() in _TABLE_ENDINGS:
        options.table = options.file
        table = read_table(options)
        return Opened(table.scenario, options.file, table, start)
    if options.verify_key:
        raise InputError(Mistake("--verify-key", options.verify_key, "is for policy tables (.h5) only"))
    if Path(options.file).suffix.lower() == ".mcap":
        if options.start is not None:
            raise InputError(Mistake("--start", options.start, "must not be given with a recording, which has its own"))
        from needleplan.recording import Recording

        return Opened.of_recording(Recording.read(options.file))
    try:
        scenario = Scenario.read(options.file)
    except ScenarioError as error:
        if any("needleplan.anatomy/" in each.value for each in error.mistakes):
            rule = "is an anatomy; `needleplan entry FILE --plane SCENARIO.toml` writes the scenario of its best plane"
            raise InputError(Mistake("", "", f"{rule}, which can be viewed"), options.file) from None
        raise
    return Opened(scenario, options.file, start=start)
