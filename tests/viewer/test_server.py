"""The server: who can reach it, its message when it cannot listen, and a clean shutdown."""

from __future__ import annotations

import asyncio
import contextlib
import http.client
import logging
import socket
import threading
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from tornado.websocket import websocket_connect

from pm3dof_pin.exceptions import ServerError
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.viewer import Viewer
from pm3dof_pin.viewer.server import is_loopback


@pytest.fixture
def viewer(mechanism: Robot) -> Iterator[Viewer]:
    with Viewer(mechanism) as started:
        yield started


def port_of(url: str) -> int:
    return int(url.rstrip("/").rpartition(":")[2])


def own_listening_addresses() -> set[str]:
    """Local addresses, as the kernel writes them, of the sockets on which this process listens."""
    inodes = set()
    for link in Path("/proc/self/fd").iterdir():
        try:
            target = str(link.readlink())
        except OSError:
            continue
        if target.startswith("socket:["):
            inodes.add(target[8:-1])
    addresses = set()
    for table in ("/proc/net/tcp", "/proc/net/tcp6"):
        if not Path(table).exists():
            continue
        for line in Path(table).read_text().splitlines()[1:]:
            words = line.split()
            if words[3] == "0A" and words[9] in inodes:
                addresses.add(words[1])
    return addresses


@pytest.mark.skipif(not Path("/proc/net/tcp").exists(), reason="reads the kernel's tables, as Linux has them")
def test_it_listens_on_loopback_only(viewer: Viewer) -> None:
    before = own_listening_addresses()
    port = port_of(viewer.start())
    assert own_listening_addresses() - before == {f"0100007F:{port:04X}"}  # 127.0.0.1, lowest byte first


def test_other_addresses_of_this_machine_are_refused(viewer: Viewer) -> None:
    """127.0.0.2 is also loopback, but not the address of the server."""
    port = port_of(viewer.start())
    with pytest.raises(ConnectionRefusedError), socket.create_connection(("127.0.0.2", port), timeout=2.0):
        pass


def test_everywhere_only_with_a_warning(mechanism: Robot, caplog: pytest.LogCaptureFixture) -> None:
    level = caplog.at_level(logging.WARNING, logger="pm3dof_pin.viewer.server")  # which the command raises
    with level, Viewer(mechanism, host="0.0.0.0") as viewer:
        url = viewer.start()
        assert url.startswith("http://localhost:")
        with urllib.request.urlopen(url) as answer:
            assert answer.status == 200
    assert "anyone who can reach this machine" in caplog.text


def test_no_warning_otherwise(viewer: Viewer, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING):
        viewer.start()
    assert caplog.text == ""


def test_what_is_loopback() -> None:
    assert is_loopback("127.0.0.1")
    assert is_loopback("localhost")
    assert is_loopback("::1")
    assert not is_loopback("0.0.0.0")
    assert not is_loopback("192.0.2.1")
    assert not is_loopback("no such host.invalid")


def test_a_taken_port(viewer: Viewer, mechanism: Robot) -> None:
    port = port_of(viewer.start())
    with (
        Viewer(mechanism, port=port) as other,
        pytest.raises(ServerError, match=rf"port {port}: Address already in use"),
    ):
        other.start()
    with Viewer(mechanism) as third:
        assert port_of(third.start()) != port  # by default, the next free one


@pytest.mark.parametrize("host", ["192.0.2.1", "no such host.invalid"])
def test_a_host_that_is_not_here(mechanism: Robot, host: str) -> None:
    with Viewer(mechanism, host=host, port=7321) as viewer, pytest.raises(ServerError, match="cannot listen on"):
        viewer.start()


def test_the_page_and_nothing_else(viewer: Viewer) -> None:
    url = viewer.start()
    assert viewer.start() == url
    with urllib.request.urlopen(url) as answer:
        assert answer.headers["Cache-Control"] == "no-store"
        assert answer.headers["X-Content-Type-Options"] == "nosniff"
        assert 'data-socket="yes"' in answer.read().decode()
    with pytest.raises(urllib.error.HTTPError, match="404") as error, urllib.request.urlopen(f"{url}etc/passwd"):
        pass
    error.value.close()


@pytest.mark.parametrize(("origin", "status"), [("http://elsewhere.example", 403), (None, 101)])
def test_other_sites_cannot_listen_in(viewer: Viewer, origin: str | None, status: int) -> None:
    """A page of another origin in the same browser may request the socket, and is refused."""
    url = viewer.start()
    headers = {
        "Connection": "Upgrade",
        "Upgrade": "websocket",
        "Sec-WebSocket-Version": "13",
        "Sec-WebSocket-Key": "AAAAAAAAAAAAAAAAAAAAAA==",
        "Origin": origin or url.rstrip("/"),
    }
    connection = http.client.HTTPConnection("127.0.0.1", port_of(url), timeout=5.0)
    with contextlib.closing(connection):
        connection.request("GET", "/socket", headers=headers)
        with connection.getresponse() as answer:
            assert answer.status == status


def test_a_change_reaches_an_open_page(viewer: Viewer) -> None:
    url = viewer.start()

    async def messages() -> tuple[Any, Any]:
        page = await websocket_connect(f"ws://127.0.0.1:{port_of(url)}/socket")
        whole = await asyncio.wait_for(page.read_message(), 10.0)
        viewer.set_title("another title")  # from a thread that is not the server's
        change = await asyncio.wait_for(page.read_message(), 10.0)
        page.close()
        assert await asyncio.wait_for(page.read_message(), 10.0) is None  # and the connection is closed
        return whole, change

    whole, change = asyncio.run(messages())
    assert "another title" not in str(whole)
    assert "another title" in str(change)


@pytest.mark.parametrize(
    ("host", "status"),
    [("localhost:8888", 200), ("127.0.0.1", 200), ("[::1]:7000", 200), ("elsewhere.example", 403), ("10.1.2.3", 403)],
)
@pytest.mark.parametrize("page", ["/", "/socket"])
def test_only_own_names_are_answered(viewer: Viewer, page: str, host: str, status: int) -> None:
    """Another site's name may resolve to this machine; the browser still sends that name."""
    url = viewer.start()
    connection = http.client.HTTPConnection("127.0.0.1", port_of(url), timeout=5.0)
    with contextlib.closing(connection):
        connection.request("GET", page, headers={"Host": host})
        with connection.getresponse() as answer:
            # anything but an upgrade to a socket is a bad request
            assert answer.status == (400 if status == 200 and page == "/socket" else status)


def test_a_server_for_others_answers_to_the_address_they_came_to(mechanism: Robot) -> None:
    with Viewer(mechanism, host="0.0.0.0") as viewer:
        port = port_of(viewer.start())
        for host, status in ((socket.gethostname(), 200), ("elsewhere.example", 403)):
            connection = http.client.HTTPConnection("127.0.0.1", port, timeout=5.0)
            with contextlib.closing(connection):
                connection.request("GET", "/", headers={"Host": f"{host}:{port}"})
                with connection.getresponse() as answer:
                    assert answer.status == status


def test_closing_leaves_nothing(mechanism: Robot) -> None:
    viewer = Viewer(mechanism)
    port = port_of(viewer.start())
    assert "scene server" in [thread.name for thread in threading.enumerate()]
    viewer.close()
    viewer.close()
    assert "scene server" not in [thread.name for thread in threading.enumerate()]
    with Viewer(mechanism, port=port) as again:
        assert port_of(again.start()) == port
    viewer.display(mechanism.home)  # still usable
    assert viewer.start()
    viewer.close()


def test_a_notebook_gets_the_address(viewer: Viewer) -> None:
    assert f'src="{viewer.start()}"' in viewer.jupyter_cell(height=432)._repr_html_()
    assert "height: 432px" in viewer.jupyter_cell(height=432)._repr_html_()


def test_no_browser_without_a_screen(viewer: Viewer, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("sys.platform", "linux")
    monkeypatch.setattr("webbrowser.open", lambda *_, **__: pytest.fail("must not be called"))
    assert viewer.open() is False
