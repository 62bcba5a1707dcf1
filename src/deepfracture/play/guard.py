"""What viser leaves open and a page on somebody's machine should not: strangers, tunnels, endless uploads.

All of this is inside viser; the tests of the page notice if a version of it has moved."""

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

FARTHEST = 1e4
"""From where one may shoot [m]."""
LONGEST = 2_000_000
"""Message that a browser may send [bytes]: parts of uploads have half a megabyte."""
LOOPBACK = ("127.0.0.1", "localhost", "::1")


def is_loopback(host: str) -> bool:
    """Whether only this machine reaches it."""
    return host in LOOPBACK


def forbid_sharing(server: ViserServer) -> None:
    """No browser may ask this machine to open a tunnel to the internet."""
    from viser import _messages

    for message in (_messages.ShareUrlRequest, _messages.ShareUrlDisconnect):
        server._websock_server.unregister_handler(message)


def stranger(server: ViserServer, client: ClientHandle) -> str:
    """Why a connection is not from a page of ours; "" if it is.

    A browser lets any web site connect to this machine's ports, but says which site it was."""
    connection = server._websock_server._live_connections.get(client.client_id)
    if connection is None or connection.request is None:
        return "it has gone"
    headers = connection.request.headers
    origin, host = headers.get("Origin"), headers.get("Host", "")
    if origin is not None and urlsplit(origin).netloc != host:
        return f"the web site {origin} opened it"
    if is_loopback(server.get_host()) and urlsplit(f"//{host}").hostname not in LOOPBACK:
        return f"it was asked for by the name {host}"
    return ""


def turn_away(server: ViserServer, client: ClientHandle) -> None:
    """Close a connection."""
    import asyncio

    connection = server._websock_server._live_connections.get(client.client_id)
    if connection is not None:
        asyncio.run_coroutine_threadsafe(connection.close(1008), server.get_event_loop())


@contextmanager
def calm() -> Iterator[None]:
    """One line in the terminal about a connection that sent what no page sends, instead of all that it sent."""
    chatter = logging.getLogger("websockets.server")

    def tell(record: logging.LogRecord) -> bool:
        if record.exc_info is None or record.getMessage() != "connection handler failed":
            return True
        log.warning(
            "play: a connection was closed that sent what no page sends (%s)", type(record.exc_info[1]).__name__
        )
        return False

    chatter.addFilter(tell)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=r"\[viser\]|Queued a \w+ on a closed connection")
        try:
            yield
        finally:
            chatter.removeFilter(tell)


def limit_messages(server: ViserServer, client: ClientHandle) -> None:
    """A longer message ends its connection: sixteen of them wait for each, and viser takes 50 MB."""
    connection = server._websock_server._live_connections.get(client.client_id)
    if connection is not None:
        connection.protocol.max_message_size = LONGEST


def is_ray(origin: object, direction: object) -> bool:
    """Whether a click says from where and where to, in numbers that mean something."""
    if not (isinstance(origin, tuple) and isinstance(direction, tuple) and len(origin) == len(direction) == 3):
        return False
    numbers = (*origin, *direction)
    if not all(isinstance(x, int | float) and math.isfinite(x) and abs(x) <= FARTHEST for x in numbers):
        return False
    return math.hypot(*direction) > 1e-6


def number(value: object, low: float, high: float, usual: float) -> float:
    """What a browser says a slider is at: within its ends, and `usual` for what is no number."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        return usual
    return min(max(float(value), low), high)


def limit_uploads(client: ClientHandle, limit: int, refused: Callable[[str, int], None]) -> None:
    """Take no file above `limit` [bytes], one at a time, and none that says that it is smaller than it is.

    `refused` is told the file's name and size."""
    from viser import _messages

    connection, gui = client._websock_connection, client.gui
    under_way = gui._current_file_upload_states

    def start(client_id: int, message: _messages.FileTransferStartUpload) -> None:
        parts = max(message.size_bytes // 1024, 1)  # the browser sends parts of half a megabyte
        if message.size_bytes > limit or message.part_count > parts:
            connection.queue_message(_messages.RemoveNotificationMessage(f"upload-{message.transfer_uuid}"))
            refused(message.filename, message.size_bytes)
            return
        under_way.clear()
        gui._handle_file_transfer_start(client_id, message)  # type: ignore[arg-type]

    def part(client_id: int, message: _messages.FileTransferPart) -> None:
        state = under_way.get(message.transfer_uuid)
        if state is None:
            return
        if state["transferred_bytes"] + len(message.content) > state["total_bytes"]:
            del under_way[message.transfer_uuid]
            refused(state["filename"], limit + 1)
            return
        gui._handle_file_transfer_part(client_id, message)  # type: ignore[arg-type]

    for message, handler in ((_messages.FileTransferStartUpload, start), (_messages.FileTransferPart, part)):
        connection.unregister_handler(message)
        connection.register_handler(message, handler)  # type: ignore[arg-type]
