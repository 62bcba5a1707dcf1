"""Names in files say which fragment of which shape."""

import numpy as np
import pytest

from deepfracture.export.names import body_names
from deepfracture.types import Mesh, Recording, Shape, Track

MESH = Mesh(np.eye(3), np.array([[0, 1, 2]]))
POT, VASE = Shape("pot", MESH), Shape("grandma's vase", MESH)


def names(*bodies):
    """Of tracks given as name, kind and whole."""
    still = np.zeros((1, 3)), np.array([[1.0, 0, 0, 0]])
    return body_names(Recording(1.0, tuple(Track(n, kind, MESH, None, 0, *still, whole) for n, kind, whole in bodies)))


def fragment(name, whole=POT):
    return name, "fragment", whole


def test_of_one_shape():
    found = names(("shape0", "shape", POT), ("ball0", "ball", None), fragment("shape0.000"), fragment("shape0.012"))
    assert found == ["pot", "ball0", "fragment_000", "fragment_012"]


def test_of_fragments_that_broke_again():
    assert names(fragment("shape0.001.000"), fragment("shape0.1204")) == ["fragment_001_000", "fragment_1204"]


def test_of_several_shapes():
    found = names(fragment("shape0.003"), fragment("shape1.003", VASE), fragment("shape2.003"))
    assert found == ["pot_fragment_003", "grandma_s_vase_fragment_003", "pot_2_fragment_003"]


@pytest.mark.parametrize("odd", ["", "7 lamps", "Ähre", "a/b.c"])
def test_of_anything_are_identifiers(odd):
    found = names((odd, "ball", None), (odd, "ball", None), fragment("half 1"), fragment("half 2"))
    assert len(set(found)) == 4 and all(name.isidentifier() and name.isascii() for name in found)
    assert found[2:] == ["fragment_000", "fragment_001"]
