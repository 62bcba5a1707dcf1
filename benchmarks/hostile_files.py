"""Malformed mesh files: truncated, misnamed, with false counts, lengths and paths."""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from hostile_solids import Corners, cube, named

File = tuple[str, str, Callable[[Path], Path]]
"""Class, name, and what writes it into a folder."""


def ply(part: Corners) -> bytes:
    """Binary, in double precision."""
    vertices, faces = part
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(vertices)}\n"
    head += "property double x\nproperty double y\nproperty double z\n"
    head += f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    rows = np.zeros(len(faces), [("n", "u1"), ("v", "<i4", 3)])
    rows["n"], rows["v"] = 3, faces
    return head.encode() + np.ascontiguousarray(vertices, "<f8").tobytes() + rows.tobytes()


def ply_text(part: Corners, vertices: int | None = None, faces: int | None = None) -> str:
    """The counts may lie."""
    head = f"ply\nformat ascii 1.0\nelement vertex {len(part[0]) if vertices is None else vertices}\n"
    head += "property float x\nproperty float y\nproperty float z\n"
    head += (
        f"element face {len(part[1]) if faces is None else faces}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    return (
        head
        + "".join(f"{x:.9g} {y:.9g} {z:.9g}\n" for x, y, z in part[0])
        + "".join(f"3 {a} {b} {c}\n" for a, b, c in part[1])
    )


def obj(part: Corners) -> str:
    return "".join(f"v {x:.17g} {y:.17g} {z:.17g}\n" for x, y, z in part[0]) + "".join(
        f"f {a} {b} {c}\n" for a, b, c in part[1] + 1
    )


def stl(part: Corners, count: int | None = None) -> bytes:
    rows = np.zeros(len(part[1]), [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("more", "<u2")])
    rows["corners"] = part[0][part[1]]
    return b"\0" * 80 + struct.pack("<I", len(rows) if count is None else count) + rows.tobytes()


def stl_text(part: Corners) -> str:
    text = "solid thing\n"
    for corners in part[0][part[1]]:
        text += " facet normal 0 0 0\n  outer loop\n"
        text += "".join(f"   vertex {x:.9g} {y:.9g} {z:.9g}\n" for x, y, z in corners) + "  endloop\n endfacet\n"
    return text + "endsolid thing\n"


def off(part: Corners, vertices: int | None = None) -> str:
    text = f"OFF\n{len(part[0]) if vertices is None else vertices} {len(part[1])} 0\n"
    text += "".join(f"{x:.9g} {y:.9g} {z:.9g}\n" for x, y, z in part[0])
    return text + "".join(f"3 {a} {b} {c}\n" for a, b, c in part[1])


def gltf(part: Corners) -> tuple[dict, bytes]:
    """The tree and the buffer of a glTF file of one mesh."""
    places, faces = part[0].astype("<f4"), part[1].astype("<u4")
    buffer = places.tobytes() + faces.tobytes()
    low, high = (places.min(0).tolist(), places.max(0).tolist()) if len(places) else ([0] * 3, [0] * 3)
    tree = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": len(places), "type": "VEC3", "min": low, "max": high},
            {"bufferView": 1, "componentType": 5125, "count": faces.size, "type": "SCALAR"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": places.nbytes},
            {"buffer": 0, "byteOffset": places.nbytes, "byteLength": faces.nbytes},
        ],
        "buffers": [{"byteLength": len(buffer)}],
    }
    return tree, buffer


def glb(tree: dict, buffer: bytes) -> bytes:
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    buffer += b"\0" * (-len(buffer) % 4)
    body = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(buffer), b"BIN\0") + buffer
    return b"glTF" + struct.pack("<II", 2, 12 + len(body)) + body


def changed(*path_and_value: object) -> bytes:
    """A cube's GLB with one value of its tree replaced: keys down to it, then the value."""
    tree, buffer = gltf(cube())
    *keys, last, value = path_and_value
    place = tree
    for key in keys:
        place = place[key]  # type: ignore[index]
    place[last] = value  # type: ignore[index]
    return glb(tree, buffer)


def bomb(side: int = 100_000) -> bytes:
    """A PNG that says it has side x side pixels, in a few bytes."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    head = struct.pack(">IIBBBBB", side, side, 8, 2, 0, 0, 0)
    return (
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", head)
        + chunk(b"IDAT", zlib.compress(b"\0" * 10_000))
        + chunk(b"IEND", b"")
    )


def _file(kind: str, name: str, suffix: str, content: Callable[[], bytes | str]) -> File:
    def write(folder: Path) -> Path:
        made = content()
        path = folder / f"mesh.{suffix}"
        path.write_bytes(made.encode() if isinstance(made, str) else made)
        return path

    return kind, name, write


def wavefront() -> Iterator[File]:
    kind = "OBJ files"
    part = cube()
    text = obj(part)
    quads = "".join(f"v {x} {y} {z}\n" for x in (0, 1) for y in (0, 1) for z in (0, 1))
    quads += "f 1 2 4 3\nf 5 7 8 6\nf 1 5 6 2\nf 3 4 8 7\nf 1 3 7 5\nf 2 6 8 4\n"
    cases = {
        "quads": quads,
        "one face of 10 thousand corners": "".join(
            f"v {np.cos(a)} {np.sin(a)} 0\n" for a in np.arange(10_000) / 1591.5
        ) + "f " + " ".join(map(str, range(1, 10_001))),
        "negative indices": "".join(f"v {x} {y} {z}\n" for x, y, z in part[0]) + "".join(
            f"f {a - 8} {b - 8} {c - 8}\n" for a, b, c in part[1]),
        "indices before the vertices": "".join(text.splitlines(True)[::-1]),
        "index 0": text + "f 0 1 2\n",
        "index past the end": text + "f 1 2 999\n",
        "index of twenty digits": text + "f 1 2 99999999999999999999\n",
        "index that is no number": text + "f 1 2 x\n",
        "missing vertex index": text + "f /1 /2 /3\n",
        "face of two corners": text + "f 1 2\n",
        "face without corners": text + "f\n",
        "vertex of two numbers": text + "v 1 2\n",
        "vertex of words": text + "v a b c\n",
        "texture index past the end": text + "vt 0 0\nf 1/1 2/2 3/3\n",
        "cut off in a number": text[: len(text) // 2],
        "cut off after the vertices": "".join(line for line in text.splitlines(True) if line[0] == "v"),
        "vertices alone": "v 0 0 0\nv 1 0 0\n",
        "zero bytes inside": text.replace("\n", "\0\n", 3),
        "not UTF-8": b"\xff\xfe" + text.encode("utf-16-le"),
        "one line of 5 million letters": "x" * 5_000_000,
        "comments alone": "# nothing\n" * 1000,
        "mtllib outside the folder": "mtllib ../../../../etc/passwd\nusemtl a\n" + text,
        "mtllib of a device": "mtllib /dev/zero\nusemtl a\n" + text,
        "mtllib of itself": "mtllib mesh.obj\nusemtl a\n" + text,
        "free-form curves": "vp 0 1\ncstype bezier\ndeg 3\ncurv 0 1 1 2 3 4\n" + text,
        "a hundred thousand materials": "".join(f"usemtl m{n}\n" for n in range(100_000)) + text,
        "carriage returns": text.replace("\n", "\r\n"),
        "continued lines": text.replace("f 1", "f \\\n1"),
        "numbers with underscores and signs": text.replace("v ", "v +", 3),
    }  # fmt: skip
    for name, content in cases.items():
        yield _file(kind, name, "obj", lambda c=content: c)

    def bombed(folder: Path) -> Path:
        (folder / "mesh.mtl").write_text("newmtl a\nmap_Kd bomb.png\n")
        (folder / "bomb.png").write_bytes(bomb())
        (folder / "mesh.obj").write_text(
            "mtllib mesh.mtl\nusemtl a\nvt 0 0\n" + text.replace("f ", "f ").replace("\n", "\n")
        )
        return folder / "mesh.obj"

    yield kind, "texture of 100000 x 100000 pixels", bombed


def polygons() -> Iterator[File]:
    kind = "PLY files"
    part = cube()
    text, data = ply_text(part), ply(part)
    head = data[: data.index(b"end_header\n") + 11]
    cases: dict[str, bytes | str] = {
        "ascii": text,
        "ascii, fewer vertices than it says": ply_text(part, vertices=20),
        "ascii, more vertices than it says": ply_text(part, vertices=5),
        "ascii, fewer faces than it says": ply_text(part, faces=2000),
        "ascii, more faces than it says": ply_text(part, faces=5),
        "ascii, a billion vertices": ply_text(part, vertices=10**9),
        "ascii, a negative count": ply_text(part, vertices=-8),
        "binary, cut off": data[: len(data) * 2 // 3],
        "binary, cut off in its head": data[:60],
        "binary, without a body": head,
        "binary, a billion vertices": data.replace(b"vertex 8", b"vertex 1000000000"),
        "binary, 1e18 vertices": data.replace(b"vertex 8", b"vertex 1000000000000000000"),
        "binary, a billion faces": data.replace(b"face 12", b"face 1000000000"),
        "binary, no face": data.replace(b"face 12", b"face 0"),
        "binary, a face of 255 corners": data[: len(head) + 8 * 24] + b"\xff" + data[len(head) + 8 * 24 + 1 :],
        "binary, index past the end": data[:-4] + struct.pack("<i", 10**9),
        "binary, index -1": data[:-4] + struct.pack("<i", -1),
        "binary in the other byte order": data.replace(b"little", b"big"),
        "property of unknown type": text.replace("float x", "quaternion x"),
        "property without a name": text.replace("property float x", "property float"),
        "list of lists": text.replace("list uchar int", "list list int"),
        "no x": text.replace("float x", "float q"),
        "no end of the head": text.replace("end_header\n", ""),
        "format unknown": text.replace("ascii 1.0", "zip 7.0"),
        "count that is no number": text.replace("vertex 8", "vertex many"),
        "texture outside the folder": text.replace("element v", "comment TextureFile ../../etc/passwd\nelement v", 1),
        "NaN in words": text.replace("0.5", "nan", 1),
        "a quad": text.replace("3 0 ", "4 0 ", 1),
    }  # fmt: skip
    for name, content in cases.items():
        yield _file(kind, name, "ply", lambda c=content: c)


def stereo() -> Iterator[File]:
    kind = "STL files"
    part = cube()
    data, text = stl(part), stl_text(part)
    cases: dict[str, bytes | str] = {
        "binary": data,
        "ascii": text,
        "binary, more faces than it says": stl(part, 3),
        "binary, fewer faces than it says": stl(part, 2000),
        "binary, four billion faces": stl(part, 2**32 - 1),
        "binary, no face": stl(part, 0),
        "binary, cut off": data[:-70],
        "binary, cut off in its head": data[:50],
        "binary that begins with solid": b"solid" + data[5:],
        "ascii, cut off in a face": text[: len(text) * 2 // 3],
        "ascii, cut off in a number": text[:130],
        "ascii, without faces": "solid thing\nendsolid thing\n",
        "ascii, words for numbers": text.replace("0.5", "half"),
        "ascii, NaN": text.replace("0.5", "nan", 1),
        "ascii, faces of four corners": text.replace("  endloop", "   vertex 0 0 0\n  endloop"),
        "ascii, two solids": text + stl_text(cube(1, (3, 0, 0))),
        "ascii in capitals": text.upper(),
        "a million zeros": b"\0" * 1_000_000,
        "noise": np.random.default_rng(0).bytes(10_000),
        "mug": stl(named("mug")),
    }
    for name, content in cases.items():
        yield _file(kind, name, "stl", lambda c=content: c)


def scenes() -> Iterator[File]:
    kind = "GLB and GLTF files"
    tree, buffer = gltf(cube())
    whole = glb(tree, buffer)
    cases: dict[str, Callable[[], bytes]] = {
        "plain": lambda: whole,
        "cut off": lambda: whole[: len(whole) // 2],
        "cut off in its head": lambda: whole[:10],
        "head alone": lambda: whole[:12],
        "length too great": lambda: whole[:8] + struct.pack("<I", 2**32 - 1) + whole[12:],
        "length zero": lambda: whole[:8] + struct.pack("<I", 0) + whole[12:],
        "tree longer than the file": lambda: whole[:12] + struct.pack("<I", 2**31) + whole[16:],
        "version 1": lambda: whole[:4] + struct.pack("<I", 1) + whole[8:],
        "tree that is no JSON": lambda: whole.replace(b'{"asset"', b'{{asset"'),
        "tree that is a list": lambda: glb([], buffer),  # type: ignore[arg-type]
        "empty tree": lambda: glb({}, buffer),
        "count of four billion": lambda: changed("accessors", 0, "count", 2**32 - 1),
        "count of 1e18": lambda: changed("accessors", 0, "count", 10**18),
        "count below zero": lambda: changed("accessors", 1, "count", -3),
        "index count not by threes": lambda: changed("accessors", 1, "count", 35),
        "count of four billion without a view": lambda: changed(
            "accessors", 0, {"componentType": 5126, "count": 2**32 - 1, "type": "VEC3"}),
        "component type unknown": lambda: changed("accessors", 0, "componentType", 9999),
        "type unknown": lambda: changed("accessors", 0, "type", "VEC9"),
        "view that is not there": lambda: changed("accessors", 0, "bufferView", 99),
        "view past the end": lambda: changed("bufferViews", 0, "byteOffset", 10**9),
        "view before the start": lambda: changed("bufferViews", 0, "byteOffset", -10**6),
        "buffer longer than the file": lambda: changed("buffers", 0, "byteLength", 10**12),
        "buffer in a file outside the folder": lambda: changed(
            "buffers", 0, {"uri": "../../../../../etc/passwd", "byteLength": 100}),
        "buffer on the net": lambda: changed("buffers", 0, {"uri": "http://127.0.0.1:9/x.bin", "byteLength": 100}),
        "buffer of a device": lambda: changed("buffers", 0, {"uri": "/dev/zero", "byteLength": 10**9}),
        "accessor that is not there": lambda: changed("meshes", 0, "primitives", 0, "attributes", "POSITION", 7),
        "lines instead of triangles": lambda: changed("meshes", 0, "primitives", 0, "mode", 1),
        "mesh that is not there": lambda: changed("nodes", 0, "mesh", 5),
        "node that is its own child": lambda: changed("nodes", 0, {"mesh": 0, "children": [0]}),
        "nodes in a ring": lambda: changed("nodes", [{"mesh": 0, "children": [1]}, {"mesh": 0, "children": [0]}]),
        "node child that is not there": lambda: changed("nodes", 0, {"mesh": 0, "children": [12]}),
        "matrix of NaN": lambda: changed("nodes", 0, {"mesh": 0, "matrix": [float("nan")] * 16}),
        "matrix of zeros": lambda: changed("nodes", 0, {"mesh": 0, "matrix": [0] * 16}),
        "matrix of five numbers": lambda: changed("nodes", 0, {"mesh": 0, "matrix": [1] * 5}),
        "mirrored": lambda: changed("nodes", 0, {"mesh": 0, "scale": [-1, 1, 1]}),
        "a thousand copies": lambda: changed("nodes", [{"mesh": 0}] + [{"mesh": 0}] * 999),
        "copies of copies, 2^40 in all": lambda: changed(
            "nodes", [{"children": [n + 1, n + 1]} for n in range(40)] + [{"mesh": 0}]),
        "nodes 5000 deep": lambda: changed("nodes", [{"children": [n + 1]} for n in range(5000)] + [{"mesh": 0}]),
        "texture of 100000 x 100000 pixels": _textured,
        "sparse accessor of four billion": lambda: changed("accessors", 0, {
            "componentType": 5126, "count": 2**32 - 1, "type": "VEC3", "sparse": {
                "count": 1, "indices": {"bufferView": 1, "componentType": 5125}, "values": {"bufferView": 0}}}),
    }  # fmt: skip
    for name, content in cases.items():
        yield _file(kind, name, "glb", content)
    text = json.dumps(tree | {"buffers": [{"uri": "mesh.bin", "byteLength": len(buffer)}]})
    yield _file(kind, "GLTF without its buffer", "gltf", lambda: text)
    yield _file(kind, "GLTF whose buffer is itself", "gltf", lambda: text.replace("mesh.bin", "mesh.gltf"))
    yield _file(kind, "GLTF, buffer in base 64 that is none", "gltf", lambda: text.replace(
        "mesh.bin", "data:application/octet-stream;base64,!!!!"))  # fmt: skip
    yield _file(kind, "GLTF, cut off", "gltf", lambda: text[:200])
    yield _file(kind, "GLTF, ten thousand brackets", "gltf", lambda: "[" * 10_000)


def _textured() -> bytes:
    tree, buffer = gltf(cube())
    picture = bomb()
    uv = np.zeros((8, 2), "<f4").tobytes()
    tree["bufferViews"] += [
        {"buffer": 0, "byteOffset": len(buffer), "byteLength": len(uv)},
        {"buffer": 0, "byteOffset": len(buffer) + len(uv), "byteLength": len(picture)},
    ]
    tree["accessors"].append({"bufferView": 2, "componentType": 5126, "count": 8, "type": "VEC2"})
    tree["images"] = [{"bufferView": 3, "mimeType": "image/png"}]
    tree["textures"] = [{"source": 0}]
    tree["materials"] = [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}]
    tree["meshes"][0]["primitives"][0] |= {"material": 0}
    tree["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_0"] = 2
    buffer += uv + picture
    tree["buffers"][0]["byteLength"] = len(buffer)
    return glb(tree, buffer)


def geomview() -> Iterator[File]:
    kind = "OFF files"
    part = cube()
    text = off(part)
    cases = {
        "plain": text,
        "fewer vertices than it says": off(part, 100),
        "more vertices than it says": off(part, 3),
        "a billion vertices": off(part, 10**9),
        "cut off": text[: len(text) // 2],
        "counts alone": "OFF\n8 12 0\n",
        "counts that are no numbers": "OFF\neight twelve 0\n",
        "index past the end": text.replace("3 0 ", "3 77 ", 1),
        "with colours": text.replace("OFF", "COFF", 1),
    }
    for name, content in cases.items():
        yield _file(kind, name, "off", lambda c=content: c)


def misnamed() -> Iterator[File]:
    kind = "mis-named and foreign files"
    contents: dict[str, Callable[[], bytes | str]] = {
        "obj": lambda: obj(cube()),
        "ply": lambda: ply(cube()),
        "stl": lambda: stl(cube()),
        "glb": lambda: glb(*gltf(cube())),
        "off": lambda: off(cube()),
    }
    for real, content in contents.items():
        for said in contents:
            if said != real:
                yield _file(kind, f"{real.upper()} called .{said}", said, content)
    for said in contents:
        yield _file(kind, f"nothing called .{said}", said, lambda: b"")
        yield _file(kind, f"noise called .{said}", said, lambda: np.random.default_rng(1).bytes(5000))
    yield _file(kind, "a picture called .obj", "obj", bomb)
    yield _file(kind, "a mesh called .txt", "txt", lambda: obj(cube()))
    yield _file(kind, "a program called .stl", "stl", lambda: b"\x7fELF" + b"\0\1" * 4000)

    def folder_called(folder: Path) -> Path:
        (folder / "mesh.obj").mkdir()
        return folder / "mesh.obj"

    def ring(folder: Path) -> Path:
        (folder / "mesh.obj").symlink_to(folder / "mesh.obj")
        return folder / "mesh.obj"

    yield kind, "a folder called .obj", folder_called
    yield kind, "a link to itself", ring
    yield kind, "a file that is not there", lambda folder: folder / "absent.ply"


def files() -> Iterator[File]:
    """Every case."""
    for family in (wavefront, polygons, stereo, scenes, geomview, misnamed):
        yield from family()
