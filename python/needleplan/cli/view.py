"""`needleplan view`: serve the interactive page on this machine."""

from __future__ import annotations

import argparse
import secrets
import threading
import webbrowser
from pathlib import Path
from typing import TYPE_CHECKING, Any

from needleplan.cli.answer import note
from needleplan.cli.interrupt import handled_signals
from needleplan.cli.options import add_verify_key, read_table
from needleplan.cli.parser import whole
from needleplan.errors import InputError, Mistake

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
        "Needs `pip install needleplan[view]`.",
    )
    parser.add_argument(
        "file", metavar="FILE", nargs="?", default="four_obstacles",
        help="a scenario (.toml), the name of a shipped scenario, or a policy table (.h5) (four_obstacles)",
    )  # fmt: skip
    add_verify_key(parser)
    parser.add_argument("--port", type=whole, metavar="N", help=f"port to serve on ({_USUAL_PORT}, or a free one)")
    parser.add_argument("--no-browser", action="store_true", help="print the address only")
    parser.add_argument("-q", "--quiet", action="store_true", help="print no remarks; errors are still printed")
    parser.set_defaults(run=_run)


def _run(options: argparse.Namespace) -> int:
    """Serve the page until a signal ends it, and return the exit code 0. Raises InputError."""
    if options.port is not None and not 0 <= options.port <= 65535:
        raise InputError(Mistake("--port", f"{options.port}", "must be a port, from 0 to 65535; 0 is any free one"))
    opened = _opened(options)
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


def _opened(options: argparse.Namespace) -> Opened:
    """Return the scenario or table that the options name. Raises InputError if it is wrong."""
    from needleplan.page import Opened
    from needleplan.scenario import Scenario

    if Path(options.file).suffix.lower() in _TABLE_ENDINGS:
        options.table = options.file
        table = read_table(options)
        return Opened(table.scenario, options.file, table)
    if options.verify_key:
        raise InputError(Mistake("--verify-key", options.verify_key, "must not be given with a scenario"))
    return Opened(Scenario.read(options.file), options.file)
