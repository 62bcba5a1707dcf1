"""Components, cut faces, small components, and the disjoint sets and hash tables beneath them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import label

from deepfracture.geometry.disjoint_sets import find, flatten, union
from deepfracture.geometry.hashing import all_distinct, lookup, table_of
from deepfracture.voxels import components_of_at_least, connected_components, connected_labels, cut_faces, merge_graph


@pytest.mark.parametrize("seed", range(3))
def test_components_are_those_of_scipy_numbered_by_first_voxels(seed: int) -> None:
    mask = np.random.default_rng(seed).random((7, 8, 9)) < 0.5
    assert (connected_components(mask, np.zeros(mask.shape, np.uint8)) == label(mask)[0]).all()


def test_labels_connect_only_to_their_own() -> None:
    labels = np.random.default_rng(0).integers(0, 3, (8, 8, 8)).astype(np.int32)
    found = connected_labels(labels)
    assert ((found > 0) == (labels > 0)).all()
    for own in (1, 2):
        assert len(np.unique(found[labels == own])) == label(labels == own)[1]
    for component in range(1, found.max() + 1):
        assert len(np.unique(labels[found == component])) == 1


def test_a_cut_face_separates() -> None:
    values = np.ones((4, 2, 2))
    cuts = np.zeros(values.shape, np.uint8)
    cuts[1] = 1
    labels = connected_components(values, cuts)
    assert (labels[:2] == 1).all() and (labels[2:] == 2).all()
    assert (cut_faces(labels) == cuts).all()
    assert (components_of_at_least(values, cuts, 9) == 1).all()


def test_the_smallest_node_merges_first_into_its_largest_contact() -> None:
    sizes, contacts = np.array([10, 1, 2, 10]), [{1: 1}, {0: 1, 2: 2}, {1: 2, 3: 1}, {2: 1}]
    assert merge_graph(sizes, contacts, np.array([1, 2]), 5).tolist() == [0, 0, 0, 3]
    assert sizes[0] == 13


def test_a_node_without_contacts_stays() -> None:
    assert merge_graph(np.array([1.0, 9.0]), [{}, {}], np.array([0]), 5.0).tolist() == [0, 1]


def test_the_lowest_node_is_the_root() -> None:
    parent = np.arange(6)
    assert union(parent, 5, 3) and union(parent, 3, 1) and not union(parent, 1, 5)
    assert find(parent, 5) == 1
    flatten(parent)
    assert parent.tolist() == [0, 1, 2, 1, 4, 1]


def test_a_hash_table_finds_what_it_holds() -> None:
    keys = np.random.default_rng(0).choice(1 << 40, 500, replace=False)
    table = table_of(keys)
    assert [lookup(table, keys, key) for key in keys] == list(range(500))
    assert lookup(table, keys, -7) == -1
    assert all_distinct(keys) and not all_distinct(np.append(keys, keys[0]))
