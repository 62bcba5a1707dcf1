"""What viser leaves open and a page on somebody's machine should not: strangers, tunnels, endless uploads.

All of this is inside viser; the tests of the page notice if a version of it has moved."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

if TYPE_CHECKING:
    from viser import ClientHandle, ViserServer

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
