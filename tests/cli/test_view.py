"""`needleplan view`: the command around the page."""

import http.client
import signal
import socket
import subprocess
import sys
from pathlib import Path
from urllib.parse import urlsplit

import pytest

from tests.anatomy.volumes import TEXT, box, write
from tests.cli.commands import TIMEOUT_S, needleplan, refused

pytestmark = pytest.mark.usefixtures("few_executions")


@pytest.mark.slow
@pytest.mark.parametrize("word", [signal.SIGINT, signal.SIGTERM])
def test_it_prints_the_address_and_serves_until_a_signal(word: signal.Signals, table_file: Path) -> None:
    command = [sys.executable, "-m", "needleplan", "view", str(table_file), "--no-browser", "--port", "0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as running:
        try:
            assert running.stdout
            address = urlsplit(running.stdout.readline().strip())
            assert address.port
            connection = http.client.HTTPConnection("127.0.0.1", address.port, timeout=TIMEOUT_S)
            connection.request("GET", "/api/start", headers={"X-Needleplan-Token": address.fragment.partition("=")[2]})
            assert connection.getresponse().status == 200
            connection.close()
            running.send_signal(word)
            _, remarks = running.communicate(timeout=TIMEOUT_S)
        finally:
            running.kill()
        assert running.returncode == 0
        assert "keep it to yourself" in remarks
        assert "Traceback" not in remarks


def test_a_port_in_use_is_refused() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        refused(needleplan("view", "--no-browser", "--port", taken.getsockname()[1]), "--port", "choose another one")
    refused(needleplan("view", "--no-browser", "--port", 70_000), "--port = 70000", "from 0 to 65535")


def test_a_key_is_for_tables(tmp_path: Path) -> None:
    (tmp_path / "key").write_text("0123456789abcdef")
    refused(
        needleplan("view", "four_obstacles", "--verify-key", tmp_path / "key"), "--verify-key", "is for policy tables"
    )


def test_a_wrong_anatomy_is_refused_before_the_page_is_served(tmp_path: Path) -> None:
    (tmp_path / "liver.toml").write_text('schema = "needleplan.anatomy/1"\n')
    refused(needleplan("view", tmp_path / "liver.toml", "--no-browser"), "liver.toml", "anatomy")
    wrong = write(tmp_path, box(), TEXT.replace('entry = "entry"', 'entry = "skin"'))
    refused(needleplan("view", wrong, "--no-browser"), "anatomy.toml", 'anatomy.entry = "skin"')


def test_in_space_the_page_has_the_choice_of_the_entry(tmp_path: Path) -> None:
    file = write(tmp_path, box())
    refused(needleplan("view", file, "--start=0,20,5"), "--start", "choose an entry in the page")
