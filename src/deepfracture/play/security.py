"""Closes what viser leaves open: connections from other web sites, tunnels, messages and uploads of any size.

This uses internals of viser; the tests of the page notice if a new version has moved them."""

from __future__ import annotations

import logging
import math
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

from deepfracture.runtime.progress import log

if TYPE_CHECKING:
    from viser import ClientHandle, ViserServer

MAX_COORDINATE = 1e4
"""Of the origin and direction of a ray [m]."""
MAX_MESSAGE = 2_000_000
"""Message from a browser [bytes]; parts of uploads have half a megabyte."""
LOOPBACK = ("127.0.0.1", "localhost", "::1")


def is_loopback(host: str) -> bool:
    """Whether only this machine can reach it."""
    return host in LOOPBACK


def forbid_sharing(server: ViserServer) -> None:
    """Ignore requests of a browser to open a tunnel to the internet."""
    from viser import _messages

    for message in (_messages.ShareUrlRequest, _messages.ShareUrlDisconnect):
        server._websock_server.unregister_handler(message)


def rejection_reason(server: ViserServer, client: ClientHandle) -> str:
    """Why a connection does not come from the page that this server delivers; "" if it does.

    A browser lets any web site connect to ports of this machine, but names the site in the `Origin` header."""
    connection = server._websock_server._live_connections.get(client.client_id)
    if connection is None or connection.request is None:
        return "it is closed already"
    headers = connection.request.headers
    origin, host = headers.get("Origin"), headers.get("Host", "")
    if origin is not None and urlsplit(origin).netloc != host:
        return f"opened by the web site {origin}"
    if is_loopback(server.get_host()) and urlsplit(f"//{host}").hostname not in LOOPBACK:
        return f"addressed to the host name {host}"
    return ""


def reject(server: ViserServer, client: ClientHandle) -> None:
    """Close a connection with the code for a policy violation."""
    import asyncio

    connection = server._websock_server._live_connections.get(client.client_id)
    if connection is not None:
        asyncio.run_coroutine_threadsafe(connection.close(1008), server.get_event_loop())


@contextmanager
def quiet_websockets() -> Iterator[None]:
    """One line in the log about a connection that sent an invalid message, instead of a traceback with the message."""
    logger = logging.getLogger("websockets.server")

    def summarise(record: logging.LogRecord) -> bool:
        if record.exc_info is None or record.getMessage() != "connection handler failed":
            return True
        log.warning("play: closed a connection that sent an invalid message (%s)", type(record.exc_info[1]).__name__)
        return False

    logger.addFilter(summarise)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=r"\[viser\]|Queued a \w+ on a closed connection")
        try:
            yield
        finally:
            logger.removeFilter(summarise)


def limit_messages(server: ViserServer, client: ClientHandle) -> None:
    """Close a connection at a message above `MAX_MESSAGE`: viser allows 50 MB and queues sixteen of them."""
    connection = server._websock_server._live_connections.get(client.client_id)
    if connection is not None:
        connection.protocol.max_message_size = MAX_MESSAGE


def is_valid_ray(origin: object, direction: object) -> bool:
    """Whether the origin and direction of a click are finite, in range, and the direction is not zero."""
    if not (isinstance(origin, tuple) and isinstance(direction, tuple) and len(origin) == len(direction) == 3):
        return False
    numbers = (*origin, *direction)
    if not all(isinstance(x, int | float) and math.isfinite(x) and abs(x) <= MAX_COORDINATE for x in numbers):
        return False
    return math.hypot(*direction) > 1e-6


def clamped_number(value: object, low: float, high: float, default: float) -> float:
    """A value that a browser sent for a slider, clamped to its range; `default` if it is no number."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        return default
    return min(max(float(value), low), high)


def limit_uploads(client: ClientHandle, limit: int, refused: Callable[[str, int], None]) -> None:
    """Accept one file at a time, none above `limit` [bytes], and none that is larger than announced.

    `refused` is called with the file's name and size."""
    from viser import _messages

    connection, gui = client._websock_connection, client.gui
    uploads = gui._current_file_upload_states

    def start(client_id: int, message: _messages.FileTransferStartUpload) -> None:
        parts = max(message.size_bytes // 1024, 1)  # the browser sends parts of half a megabyte
        if message.size_bytes > limit or message.part_count > parts:
            connection.queue_message(_messages.RemoveNotificationMessage(f"upload-{message.transfer_uuid}"))
            refused(message.filename, message.size_bytes)
            return
        uploads.clear()
        gui._handle_file_transfer_start(client_id, message)  # type: ignore[arg-type]

    def part(client_id: int, message: _messages.FileTransferPart) -> None:
        state = uploads.get(message.transfer_uuid)
        if state is None:
            return
        if state["transferred_bytes"] + len(message.content) > state["total_bytes"]:
            del uploads[message.transfer_uuid]
            refused(state["filename"], limit + 1)
            return
        gui._handle_file_transfer_part(client_id, message)  # type: ignore[arg-type]

    for message, handler in ((_messages.FileTransferStartUpload, start), (_messages.FileTransferPart, part)):
        connection.unregister_handler(message)
        connection.register_handler(message, handler)  # type: ignore[arg-type]
