"""The web server of the page, with a world for each tab."""

from __future__ import annotations

import io
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from deepfracture.export.viser_scene import add_floor
from deepfracture.play.breaker_cache import BreakerCache
from deepfracture.play.library import Library
from deepfracture.play.player import Player
from deepfracture.play.security import (
    forbid_sharing,
    is_loopback,
    limit_messages,
    quiet_websockets,
    reject,
    rejection_reason,
)
from deepfracture.runtime.extras import require
from deepfracture.runtime.files import scratch_folder
from deepfracture.runtime.progress import log
from deepfracture.types import BadInput
from deepfracture.world import UPRIGHT

if TYPE_CHECKING:
    from viser import ClientHandle, ViserServer

BRAND = (189, 94, 61)
BACKDROP = (255, 255, 255)
"""Colour of the background, into which the floor fades."""


@dataclass(frozen=True)
class Options:
    """How the page is served."""

    shape: str | None = None
    """Built-in shape or mesh file to begin with."""
    model: Path | None = None
    """Its trained weights, instead of the shipped ones."""
    up: str | None = None
    """Axis of the file that points up; None: the usual one of its file type."""
    host: str = "127.0.0.1"
    port: int = 8080
    upload_limit: int = 64_000_000
    """Largest file that can be uploaded [bytes]."""
    most_tabs: int = 8
    """Greatest number of tabs at once, each with its own world."""

    def __post_init__(self) -> None:
        if not 0 <= self.port < 65536:
            raise BadInput(f"--port must be from 0 to 65535, got {self.port}")
        if self.up is not None and self.up not in UPRIGHT:
            raise BadInput(f"--up must be x, y or z, got {self.up!r}")
        if self.most_tabs < 1:
            raise BadInput(f"--most-tabs must be at least 1, got {self.most_tabs}")
        if self.upload_limit <= 0:
            raise BadInput(f"--upload-limit must be positive, got {self.upload_limit / 1e6:g}")


def serve(options: Options) -> None:
    """Serve the page until Ctrl+C."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # so that uploads are removed then, too
    with page(options) as url:
        log.warning("Open %s in a browser. Press Ctrl+C to stop.", url)
        if not is_loopback(options.host):
            log.warning("Anyone who can reach %s can use the page and upload meshes.", options.host)
        with suppress(KeyboardInterrupt):  # the way to stop
            threading.Event().wait()


@contextmanager
def page(options: Options) -> Iterator[str]:
    """Serves the page while the context lasts; yields its address. BadInput: the shape or model cannot be used."""
    require("viser", extra="play", to="play in the browser")
    import viser

    library, breakers = Library(options.shape, model=options.model, up=options.up), BreakerCache()
    if options.model is not None:
        breakers.breaker(library.entry(library.first), "learned", "plaster")  # raises if the model does not fit
    players: dict[int, Player] = {}
    with redirect_stdout(io.StringIO()):  # viser prints its own address
        server = viser.ViserServer(host=options.host, port=options.port, label="deepfracture", verbose=False)
    with scratch_folder() as folder:
        try:
            forbid_sharing(server)
            _set_up_scene(server)
            _accept_clients(server, library, breakers, folder, players, options)
            with quiet_websockets():
                yield f"http://{'localhost' if options.host == '0.0.0.0' else options.host}:{server.get_port()}"
        finally:
            for player in list(players.values()):
                player.stop()
            with redirect_stdout(io.StringIO()):
                server.stop()


def _set_up_scene(server: ViserServer) -> None:
    """What all tabs share: the floor, the fog, the theme of the panel."""
    server.gui.configure_theme(show_logo=False, show_share_button=False, brand_color=BRAND, control_width="medium")
    server.scene.set_up_direction("+z")
    server.scene.configure_fog(10.0, 45.0, color=BACKDROP)
    add_floor(server.scene, 0.0)


def _accept_clients(
    server: ViserServer,
    library: Library,
    breakers: BreakerCache,
    folder: Path,
    players: dict[int, Player],
    options: Options,
) -> None:
    lock = threading.Lock()

    @server.on_client_connect
    def _(client: ClientHandle) -> None:
        reason = rejection_reason(server, client)
        if reason:
            log.warning("play: rejected a connection: %s", reason)
            reject(server, client)
            return
        limit_messages(server, client)
        with lock:
            if len(players) >= options.most_tabs:
                client.add_notification("Too many tabs", f"{options.most_tabs} are open; close one and reload.")
                return
            own = folder / f"tab_{client.client_id}"
            players[client.client_id] = Player(client, library, breakers, own, upload_limit=options.upload_limit)
        player = players[client.client_id]

        @client.scene.on_click()
        def _(event) -> None:
            player.click(event.ray_origin, event.ray_direction)

    @server.on_client_disconnect
    def _(client: ClientHandle) -> None:
        with lock:
            player = players.pop(client.client_id, None)
        if player is not None:
            player.stop()
