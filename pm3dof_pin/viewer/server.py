"""A small server for the page, on the loopback interface by default."""

from __future__ import annotations

import asyncio
import contextlib
import ipaddress
import json
import logging
import os
import socket
import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any
from urllib.parse import urlsplit

from tornado.httpserver import HTTPServer
from tornado.web import Application, HTTPError, RequestHandler
from tornado.websocket import WebSocketClosedError, WebSocketHandler

from pm3dof_pin.exceptions import ServerError
from pm3dof_pin.viewer.scene import Message, Scene

_logger = logging.getLogger(__name__)

FIRST_PORT = 7000
_PORTS_TRIED = 100


class SceneServer:
    """Serves a page at "/" and sends all changes of a scene to the browsers that show it.

    Raises:
        ServerError: the port is in use, or the host is not an address of this machine.
    """

    def __init__(self, scene: Scene, page: Callable[[], str], host: str, port: int | None) -> None:
        self.host = host
        self._scene = scene
        self._page = page
        self._socket = _bind(host, port)
        self.port: int = self._socket.getsockname()[1]
        if not is_loopback(host):
            _logger.warning("listening on %s: anyone who can reach this machine can see the scene", host)
        ready: Future[None] = Future()
        self._loop = asyncio.new_event_loop()
        self._stop = asyncio.Event()
        self._thread = threading.Thread(target=self._run, args=(ready,), name="scene server", daemon=True)
        self._thread.start()
        ready.result()

    @property
    def url(self) -> str:
        """Address for a browser on this machine."""
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"http://{'localhost' if host in ('0.0.0.0', '[::]') else host}:{self.port}/"

    def close(self) -> None:
        """Stop listening and end all connections; a second call does nothing."""
        if self._thread.is_alive():
            self._loop.call_soon_threadsafe(self._stop.set)
            self._thread.join()

    def _run(self, ready: Future[None]) -> None:
        with contextlib.closing(self._loop):
            self._loop.run_until_complete(self._serve(ready))
            self._loop.run_until_complete(self._loop.shutdown_asyncgens())

    async def _serve(self, ready: Future[None]) -> None:
        handlers: set[_Socket] = set()
        shared = {"scene": self._scene, "loop": self._loop, "handlers": handlers}
        rooms: list[Any] = [(r"/", _Page, {"page": self._page}), (r"/socket", _Socket, shared)]
        server = HTTPServer(Application(rooms, own_host=self.host))
        server.add_socket(self._socket)
        ready.set_result(None)
        await self._stop.wait()
        server.stop()
        for handler in list(handlers):
            handler.disconnect()
        await server.close_all_connections()


class _OwnAddressOnly(RequestHandler):
    """Answers only requests made by a name of this machine, against DNS rebinding."""

    def prepare(self) -> None:
        """Refuse requests to other names, and from pages of other origins."""
        host = self.request.host.strip().lower()
        if not self._is_own(_name_in(host)):
            raise HTTPError(403, f"not a name of this machine: {host}")
        origin = self.request.headers.get("Origin")
        if origin is not None and urlsplit(origin).netloc.lower() != host:
            raise HTTPError(403, f"not from a page of this server: {origin}")

    def _is_own(self, name: str) -> bool:
        listening: str = self.application.settings["own_host"]
        if name in (listening.lower(), "localhost") or _is_loopback_address(name):
            return True
        if is_loopback(listening):
            return False
        here = self.request.connection.stream.socket.getsockname()[0]  # type: ignore[union-attr]
        return name in (str(here).partition("%")[0], socket.gethostname().lower(), socket.getfqdn().lower())


class _Page(_OwnAddressOnly):
    def initialize(self, page: Callable[[], str]) -> None:
        self._page = page

    def get(self) -> None:
        """Send the page; browsers do not cache it, since the next one may show another machine."""
        self.set_header("Cache-Control", "no-store")
        self.set_header("X-Content-Type-Options", "nosniff")
        self.write(self._page())


class _Socket(_OwnAddressOnly, WebSocketHandler):
    def initialize(self, scene: Scene, loop: asyncio.AbstractEventLoop, handlers: set[Any]) -> None:
        self._scene = scene
        self._loop = loop
        self._handlers = handlers

    def open(self, *args: str, **kwargs: str) -> None:
        """Send the scene, and from now on every change."""
        self._handlers.add(self)
        self._send(self._scene.listen(self._on_message))

    def on_message(self, message: str | bytes) -> None:
        """Ignore messages from pages."""

    def on_close(self) -> None:
        """Forget the page."""
        self._handlers.discard(self)
        self._scene.unsubscribe(self._on_message)

    def disconnect(self) -> None:
        """Close the connection from this side."""
        self._scene.unsubscribe(self._on_message)
        self.close()

    def _on_message(self, message: Message) -> None:
        # called in the thread that changes the scene; the connection belongs to the server's thread
        self._loop.call_soon_threadsafe(self._send, message)

    def _send(self, message: Message) -> None:
        with contextlib.suppress(WebSocketClosedError):
            self.write_message(json.dumps(message, allow_nan=False))


def is_loopback(host: str) -> bool:
    """Return whether only programs of this machine can connect to a host name or address."""
    try:
        addresses = {entry[4][0] for entry in socket.getaddrinfo(host, None)}
    except OSError:
        return False
    return all(ipaddress.ip_address(str(address).partition("%")[0]).is_loopback for address in addresses)


def _name_in(host: str) -> str:
    """Return the name or address of a Host header, without port and brackets."""
    if host.startswith("["):
        return host[1:].partition("]")[0]
    return host.rpartition(":")[0] if host.count(":") == 1 else host


def _is_loopback_address(name: str) -> bool:
    try:
        return ipaddress.ip_address(name).is_loopback
    except ValueError:
        return False


def _bind(host: str, port: int | None) -> socket.socket:
    tried = [port] if port is not None else list(range(FIRST_PORT, FIRST_PORT + _PORTS_TRIED))
    reason = ""
    for candidate in tried:
        try:
            family, *_, address = socket.getaddrinfo(host, candidate, type=socket.SOCK_STREAM)[0]
            listening = socket.create_server(address[:2], family=family, backlog=128)
        except OSError as error:
            reason = os.strerror(error.errno) if error.errno and error.errno > 0 else str(error.strerror or error)
        else:
            listening.setblocking(False)
            return listening
    ports = f"port {tried[0]}" if port is not None else f"any port from {tried[0]} to {tried[-1]}"
    raise ServerError(f"cannot listen on {host}, {ports}: {reason}")
