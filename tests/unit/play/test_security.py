"""What viser leaves open is shut: it lies inside viser, so a version of it may move."""

from types import SimpleNamespace

import pytest

from deepfracture.play import Options
from deepfracture.play.security import forbid_sharing, limit_uploads, rejection_reason
from deepfracture.types import BadInput


@pytest.fixture(scope="module")
def server():
    viser = pytest.importorskip("viser")
    opened = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    yield opened
    opened.stop()


def test_no_browser_can_ask_for_a_tunnel(server):
    from viser import _messages

    assert _messages.ShareUrlRequest in server._websock_server._incoming_handlers
    forbid_sharing(server)
    assert _messages.ShareUrlRequest not in server._websock_server._incoming_handlers
    assert _messages.ShareUrlDisconnect not in server._websock_server._incoming_handlers


@pytest.mark.parametrize(
    ("headers", "strange"),
    [
        ({"Host": "127.0.0.1:8080", "Origin": "http://127.0.0.1:8080"}, False),
        ({"Host": "localhost:8080"}, False),
        ({"Host": "127.0.0.1:8080", "Origin": "https://evil.example"}, True),
        ({"Host": "127.0.0.1:8080", "Origin": "http://127.0.0.1:9000"}, True),
        ({"Host": "evil.example:8080", "Origin": "http://evil.example:8080"}, True),  # a name that leads back here
    ],
)
def test_other_web_sites_are_strangers(server, headers, strange):
    connections = server._websock_server._live_connections
    connections[77] = SimpleNamespace(request=SimpleNamespace(headers=headers))
    try:
        assert bool(rejection_reason(server, SimpleNamespace(client_id=77))) == strange
    finally:
        del connections[77]


def test_uploads_end_at_the_limit_whatever_the_browser_says(server):
    from viser import _messages
    from viser._gui_api import GuiApi
    from viser.infra import WebsockMessageHandler

    sent, refused = [], []

    class Line(WebsockMessageHandler):
        def queue_message(self, message):
            sent.append(type(message).__name__)

        def get_message_buffer(self):
            raise AssertionError

    line = Line()
    gui = SimpleNamespace(
        _current_file_upload_states={}, _handle_file_transfer_start=None, _handle_file_transfer_part=None
    )
    gui._handle_file_transfer_start = lambda who, m: gui._current_file_upload_states.update(
        {m.transfer_uuid: {"filename": m.filename, "transferred_bytes": 0, "total_bytes": m.size_bytes}}
    )
    assert hasattr(GuiApi, "_handle_file_transfer_start") and hasattr(GuiApi, "_handle_file_transfer_part")
    taken = []
    gui._handle_file_transfer_part = lambda who, m: taken.append(len(m.content))
    for message in (_messages.FileTransferStartUpload, _messages.FileTransferPart):
        line.register_handler(message, lambda who, m: None)
    client = SimpleNamespace(_websock_connection=line, gui=gui)
    limit_uploads(client, 1000, lambda name, size: refused.append((name, size)))
    (start,) = line._incoming_handlers[_messages.FileTransferStartUpload]
    (part,) = line._incoming_handlers[_messages.FileTransferPart]

    def begin(uuid, size, parts=1):
        start(0, _messages.FileTransferStartUpload("button", uuid, "a.obj", "", parts, size))

    begin("large", 1001)
    begin("many", 900, parts=10**6)
    assert refused == [("a.obj", 1001), ("a.obj", 900)] and not gui._current_file_upload_states
    begin("fine", 900)
    part(0, _messages.FileTransferPart("button", "fine", 0, b"x" * 900))
    assert taken == [900]
    part(0, _messages.FileTransferPart("button", "fine", 1, b"x" * 901))  # more than it said
    part(0, _messages.FileTransferPart("button", "fine", 2, b"x"))
    assert taken == [900] and len(refused) == 3


def test_options_that_cannot_be_are_refused():
    with pytest.raises(BadInput, match="--port"):
        Options(port=70000)
    with pytest.raises(BadInput, match="--up must be"):
        Options(up="w")
    with pytest.raises(BadInput, match="--upload-limit"):
        Options(upload_limit=0)
