"""The page is one file that names no address."""

import io
import re
import runpy
from dataclasses import replace
from pathlib import Path

import pygltflib
from PIL import Image

from deepfracture.export import write_page

tools = runpy.run_path(str(Path(__file__).parents[2] / "tools" / "recordings.py"))
painted = runpy.run_path(str(Path(__file__).parents[2] / "tools" / "painted.py"))


def test_the_page_is_one_file_that_holds_the_recording(tmp_path, capfd):
    write_page(tools["broken_octahedron"](), tmp_path / "page.html")
    html = (tmp_path / "page.html").read_text()
    assert 0.5e6 < len(html) < 5e6
    assert "__VISER_EMBED_DATA__" in html
    assert not re.search(r"""<(script|link|img)[^>]*(src|href)=["']https?:""", html)
    assert [p.name for p in tmp_path.iterdir()] == ["page.html"]
    assert capfd.readouterr().out == ""  # nothing but the program's own lines on its output


def test_painted_surfaces_travel_with_a_small_texture(tmp_path, monkeypatch):
    import viser

    sent = []
    monkeypatch.setattr(viser.SceneApi, "add_glb", lambda self, name, data, **options: sent.append((name, data)))
    shape, fragments = painted["broken_cube"](tmp_path)
    large = io.BytesIO()
    Image.effect_noise((2048, 1024), 50).save(large, format="PNG")
    finishes = (replace(shape.appearance.finishes[0], texture=large.getvalue()), shape.appearance.finishes[1])
    shape = replace(shape, appearance=replace(shape.appearance, finishes=finishes))
    write_page(painted["filmed"](shape, fragments), tmp_path / "page.html")
    assert len(sent) > len(fragments) / 2 and all("outer" in name for name, _ in sent)
    for _, data in sent:
        document = pygltflib.GLTF2.load_from_bytes(data)
        (view,) = (document.bufferViews[image.bufferView] for image in document.images)
        picture = document.binary_blob()[view.byteOffset : view.byteOffset + view.byteLength]
        assert Image.open(io.BytesIO(picture)).size == (512, 256)
        assert document.meshes[0].primitives[0].attributes.TEXCOORD_0 is not None
