# SPDX-License-Identifier: Apache-2.0
"""Server of the page: viser's, behind a guard.

viser serves whoever connects. The guard refuses pages of other origins and names of other hosts, so that no
page in the user's browser can reach it, asks for a token where other machines can connect, and limits clients,
sizes and rates of messages. viser's tunnel to a public address, which any client may request, is taken out.
"""

import asyncio
import contextlib
import functools
import io
import logging
import secrets
import socket
import threading
import time
from http import HTTPStatus
from http.cookies import CookieError, SimpleCookie
from importlib.util import find_spec
from urllib.parse import parse_qs, urlsplit

from liegroup_core.errors import LieGroupSimError

LOOPBACK = ("127.0.0.1", "localhost", "::1")
MOST_CLIENTS = 8
MOST_BYTES = 16 * 2**20  # of a message of a client: a picture that it has drawn
MOST_RATE = 500.0  # messages of a client in a second; a mouse that is dragged sends about 60
LONGEST_LINE = 2**13  # bytes of a request that websockets reads
LONGEST_PATH = 200  # characters of an address; a name of a file has at most 255 bytes
COOKIE = "liegroup_view"
HINT = "pip install 'liegroup_sim_ros[view]'"
_patching = threading.Lock()


class ViewError(LieGroupSimError):
    """The page is not possible; one line of text, exit code 2."""


def open_server(host, port, title):
    """(ViserServer, address with the token if one is needed) on a port, or on the next one that is free.

    Raises ViewError if viser is not installed, there is no such port, or the host is not one of this machine.
    """
    if find_spec("viser") is None:
        raise ViewError(f"the page needs the package viser: {HINT}")
    import viser
    import websockets.asyncio.server as sockets

    token = None if host in LOOPBACK else secrets.token_urlsafe(24)
    guard = _Guard(token)
    logging.getLogger("websockets").setLevel(logging.CRITICAL)  # a client that sends nonsense is cut off
    with _patching, contextlib.redirect_stdout(io.StringIO()):
        serve = sockets.serve
        sockets.serve = functools.partial(_serve, serve, guard)
        try:
            server = _started(viser, host, port)
        finally:
            sockets.serve = serve
    guard.connections = server._websock_server._live_connections
    for message in (viser._messages.ShareUrlRequest, viser._messages.ShareUrlDisconnect):
        server._websock_server.unregister_handler(message)
    server.gui.configure_theme(show_logo=False, show_share_button=False, control_width="medium")
    server.gui.set_panel_label(title)
    shown = socket.gethostname() if host in ("0.0.0.0", "::") else host
    return server, f"http://{shown}:{server.get_port()}" + (f"/?token={token}" if token else "")


def mover(server, handle):
    """(function position (3,), function wxyz (4,)) that move a node, at a third of the cost of setting its properties.

    These compare with the last values and cast every number.
    """
    import viser

    messages, send, name = viser._messages, server._websock_server.queue_message, handle.name
    return (
        lambda position: send(messages.SetPositionMessage(name, tuple(position))),
        lambda wxyz: send(messages.SetOrientationMessage(name, tuple(wxyz))),
    )


def close_server(server):
    """End the server; open pages say that it is gone."""
    with contextlib.redirect_stdout(io.StringIO()):
        server.stop()


def _started(viser, host, port):
    if not 0 < port < 65536:
        raise ViewError(f"--port {port}: give a number from 1 to 65535")
    with socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET) as probe:
        try:  # viser would try a thousand ports and then wait for ever
            probe.bind((host, 0))
        except OSError as error:
            raise ViewError(f"--host {host}: {error.strerror or error}; give an address of this machine") from None
    return viser.ViserServer(host=host, port=port, verbose=False)


def _serve(serve, guard, handler, *arguments, process_request=None, **options):
    """websockets' serve with the guard around viser's handler."""

    async def guarded(connection):
        await handler(_Calm(connection))

    def process(connection, request):
        refused = guard.refusal(connection, request)
        return refused if refused is not None else process_request(connection, request)

    options |= {"max_size": MOST_BYTES, "create_connection": _answering()}
    return serve(guarded, *arguments, process_request=process, **options)


@functools.cache
def _answering():
    """Class of connections that answer the requests that websockets does not read: it would close them in silence."""
    from websockets.asyncio.server import ServerConnection

    class Answering(ServerConnection):
        start, is_answered = b"", False

        def data_received(self, data):
            if self.request is None:
                self.start = (self.start + data)[:LONGEST_LINE]
            super().data_received(data)

        def send_data(self):
            if self.protocol.handshake_exc is not None and self.request is None and not self.is_answered:
                self.is_answered = True
                line, end, _ = self.start.partition(b"\n")
                status = HTTPStatus(414 if not end else 400 if line.startswith(b"GET ") else 405)
                head = f"HTTP/1.1 {status} {status.phrase}\r\nAllow: GET\r\nContent-Length: 0\r\nConnection: close"
                self.transport.write(f"{head}\r\n\r\n".encode())
            super().send_data()

    return Answering


class _Guard:
    """Decides about requests. connections: {client: connection} that are open."""

    def __init__(self, token):
        self._token, self.connections = token, {}

    def refusal(self, connection, request):
        """Response to a request that is refused or moved, or None."""
        if len(request.path) > LONGEST_PATH:
            return connection.respond(HTTPStatus.REQUEST_URI_TOO_LONG, "The path is too long.\n")
        headers = request.headers
        hosts = headers.get_all("Host")
        try:
            name = urlsplit(f"//{hosts[0]}").hostname if len(hosts) == 1 else None
        except ValueError:
            name = None
        if name is None or (self._token is None and name not in LOOPBACK):
            return connection.respond(HTTPStatus.FORBIDDEN, "The page is at localhost only.\n")
        if headers.get("Upgrade") == "websocket":
            if headers.get_all("Origin") not in ([f"http://{hosts[0]}"], [f"https://{hosts[0]}"]):
                return connection.respond(HTTPStatus.FORBIDDEN, "Pages of other origins are refused.\n")
            if len(self.connections) >= MOST_CLIENTS:
                return connection.respond(HTTPStatus.SERVICE_UNAVAILABLE, "Too many pages are open.\n")
        if self._token is None or self._is_known(headers):
            return None
        given = parse_qs(urlsplit(request.path).query).get("token", [""])[0]
        if not secrets.compare_digest(given.encode(), self._token.encode()):
            return connection.respond(HTTPStatus.FORBIDDEN, "Open the address with the token that was printed.\n")
        moved = connection.respond(HTTPStatus.FOUND, "")
        moved.headers["Location"] = "/"
        moved.headers["Set-Cookie"] = f"{COOKIE}={self._token}; HttpOnly; SameSite=Strict; Path=/"
        return moved

    def _is_known(self, headers):
        for text in headers.get_all("Cookie"):
            with contextlib.suppress(CookieError):
                morsel = SimpleCookie(text).get(COOKIE)
                if morsel is not None and secrets.compare_digest(morsel.value.encode(), self._token.encode()):
                    return True
        return False


class _Calm:
    """Connection whose messages are received at MOST_RATE at most; the client waits."""

    def __init__(self, connection):
        self._connection, self._free = connection, 0.0

    def __getattr__(self, name):
        return getattr(self._connection, name)

    async def recv(self):
        """Next message."""
        data = await self._connection.recv()
        now = time.monotonic()
        self._free = max(self._free, now - 1.0) + 1.0 / MOST_RATE  # a second's messages may come at once
        if self._free > now:
            await asyncio.sleep(self._free - now)
        return data
