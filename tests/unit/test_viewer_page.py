"""The page is one file that names no address."""

import re
import runpy
from pathlib import Path

from deepfracture.viewer import write_page

tools = runpy.run_path(str(Path(__file__).parents[1] / "tools" / "recordings.py"))


def test_the_page_is_one_file_that_holds_the_recording(tmp_path, capfd):
    write_page(tools["broken_octahedron"](), tmp_path / "page.html")
    html = (tmp_path / "page.html").read_text()
    assert 0.5e6 < len(html) < 5e6
    assert "__VISER_EMBED_DATA__" in html
    assert not re.search(r"""<(script|link|img)[^>]*(src|href)=["']https?:""", html)
    assert [p.name for p in tmp_path.iterdir()] == ["page.html"]
    assert capfd.readouterr().out == ""  # nothing but the program's own lines on its output
