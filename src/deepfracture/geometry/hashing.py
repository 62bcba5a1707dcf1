"""Hash tables with open addressing and linear probing, for compiled code.

A table holds rows of an array of keys, -1 where it is empty; the keys themselves stay in their array. Nothing depends
on the order in which keys collide.
"""

from __future__ import annotations

import numpy as np
from numba import njit

LOAD = 3
"""Slots for each key, at least."""


@njit(cache=True)
def empty_table(count: int) -> np.ndarray:  # pragma: no cover
    """A table for up to `count` keys; its size is a power of two."""
    size = 16
    while size < LOAD * count:
        size *= 2
    return np.full(size, -1, np.int32)


@njit(cache=True, inline="always")
def _slot(key: int, table: np.ndarray) -> int:
    """Multiplicative hashing (Knuth 1973, 6.4): the middle bits of a product with the golden ratio."""
    return (key * 0x9E3779B97F4A7C1) >> 20 & (len(table) - 1)


@njit(cache=True, inline="always")
def insert(table: np.ndarray, keys: np.ndarray, row: int) -> int:
    """Add keys[row], unless the table holds an equal key; the row of that key."""
    at = _slot(keys[row], table)
    while table[at] >= 0 and keys[table[at]] != keys[row]:
        at = (at + 1) & (len(table) - 1)
    if table[at] < 0:
        table[at] = row
    return table[at]


@njit(cache=True, inline="always")
def insert_pair(table: np.ndarray, keys: np.ndarray, row: int) -> int:
    """`insert` for keys of two integers, shape (n, 2)."""
    at = _slot(keys[row, 0] + 3 * keys[row, 1], table)
    while table[at] >= 0 and (keys[table[at], 0] != keys[row, 0] or keys[table[at], 1] != keys[row, 1]):
        at = (at + 1) & (len(table) - 1)
    if table[at] < 0:
        table[at] = row
    return table[at]


@njit(cache=True, inline="always")
def lookup(table: np.ndarray, keys: np.ndarray, key: int) -> int:
    """The row of a key, -1 if the table does not hold it."""
    at = _slot(key, table)
    while table[at] >= 0 and keys[table[at]] != key:
        at = (at + 1) & (len(table) - 1)
    return table[at]


@njit(cache=True)
def table_of(keys: np.ndarray) -> np.ndarray:  # pragma: no cover
    """The table of some keys, for `lookup`."""
    table = empty_table(len(keys))
    for row in range(len(keys)):
        insert(table, keys, row)
    return table


@njit(cache=True, nogil=True)
def all_distinct(keys: np.ndarray) -> bool:  # pragma: no cover
    """Whether no key comes twice."""
    table = empty_table(len(keys))
    distinct = True
    for row in range(len(keys)):
        distinct = distinct and insert(table, keys, row) == row
    return distinct
