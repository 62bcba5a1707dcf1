"""Fragments that may break again: shapes in their own right, and the way back.

A fragment lives in the body frame of the whole that it comes from, whatever its generation. To be broken it
gets a frame of its own, in which it is two metres long; the breaker is asked there, about an impact scaled by
dynamic similarity (same material, speed and stress; see `fracture.similar` for toughness and lengths). What it
answers is scaled back, so that all fragments, masses and impulses of the world are real ones.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from deepfracture.geometry import normalise
from deepfracture.types import Floats, Fragment, Fragments, Impact, Ints, Shape

SMALLEST_SHARE = 0.02
"""Of the volume of the whole: a smaller fragment never breaks again."""
HARDER = 1.5
"""A fragment that has withstood a blow is asked about another only if that is so many times as strong: weaker
ones come by the hundred, as what has just broken jostles."""
SAME_BLOW = 0.02
"""Age below which a fragment does not break [s]: what pushes it so soon is the blow that made it, and the
whole of that blow has been spent on breaking once."""


def as_shape(fragment: Fragment, name: str, whole: Shape) -> Shape:
    """A fragment of `whole` in a frame of its own; `Shape.to_user` still leads to the user's file."""
    own = normalise(fragment.mesh, name)
    centre = whole.to_user(own.centre)
    return replace(own, scale=own.scale * whole.scale, centre=centre, size=own.scale, whole=whole)


def scaled(impact: Impact, piece: Shape) -> Impact:
    """An impact in the frame of the whole, as it is in a piece's own frame: I / s^3 at R / s."""
    size = piece.size
    return Impact(
        (impact.position - _middle(piece)) / size,
        impact.direction,
        impact.magnitude / size**3,
        impact.normal,
        impact.speed,
        impact.radius / size,
    )


def real(fragments: Fragments, piece: Shape, source: Ints) -> Fragments:
    """What a piece broke into, in the frame of the whole; `source` of the piece's own faces in the whole."""
    return Fragments(tuple(_real(fragment, piece.size, _middle(piece), source) for fragment in fragments))


def _real(fragment: Fragment, size: float, middle: Floats, source: Ints) -> Fragment:
    cracked = fragment.source < 0
    return Fragment(
        fragment.mesh.moved(size, middle),
        np.where(cracked, -1, source[fragment.source]),
        fragment.mass * size**3,
        fragment.centre * size + middle,
        fragment.inertia * size**5,
    )


def _middle(piece: Shape) -> Floats:
    """Centre of a piece's box in the frame of the whole."""
    assert piece.whole is not None
    return (piece.centre - piece.whole.centre) / piece.whole.scale
