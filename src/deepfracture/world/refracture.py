"""Fragments that may break again: conversion to a shape of their own, and back.

A fragment lives in the body frame of the whole that it comes from, whatever its generation. To break, it gets a frame
of its own, in which it is two metres long; the breaker is called there, with an impact scaled by dynamic similarity
(same material, speed and stress; see `fracture.similarity` for toughness and lengths). The result is scaled back, so
fragments, masses and impulses of the world always have their true size.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from deepfracture.geometry import normalise
from deepfracture.types import Floats, Fragment, Fragments, Impact, Ints, Shape
from deepfracture.world.collisions import CollisionEvent
from deepfracture.world.rigid_body import RigidBody
from deepfracture.world.scene import Scene

MIN_VOLUME_FRACTION = 0.02
"""Of the volume of the whole: a smaller fragment never breaks again."""
IMPULSE_RATIO = 1.5
"""A fragment that has withstood an impulse is tested again only with one that is so many times as strong: hundreds of
weaker ones occur while what has just broken jostles."""
REFRACTURE_DELAY = 0.02
"""Age below which a fragment does not break [s]: so soon it is pushed by the impact that created it, all of which
has been spent on breaking once."""


class RefractureFilter:
    """Which collisions of fragments a breaker is called for. For a whole shape it is called for every one."""

    def __init__(self, scene: Scene) -> None:
        self._generations, self._balls_only = scene.refracture, scene.refracture_by == "balls"
        self._withstood: dict[int, float] = {}
        """Strongest impulse by which each fragment did not break [N s]."""

    def shape(self, fragment: Fragment, name: str, whole: Shape, generation: int) -> Shape | None:
        """A fragment as a shape, if it is large enough and of an early enough generation to break again."""
        if generation > self._generations or fragment.volume < MIN_VOLUME_FRACTION * whole.mesh.volume:
            return None
        return fragment_as_shape(fragment, name, whole)

    def may_break(self, body: RigidBody, balls: list[RigidBody], time: float) -> bool:
        """Whether a breakable body may break at this time [s]; `balls` are those fast enough to break fragments."""
        if body.generation == 0:
            return True
        if self._balls_only:
            return any(ball.created > body.created for ball in balls)
        return time - body.created > REFRACTURE_DELAY

    def is_stronger(self, event: CollisionEvent) -> bool:
        """Whether an impact is stronger than those that the body has withstood (see `IMPULSE_RATIO`)."""
        if event.body.generation == 0:
            return True
        impulse = float(event.impact.magnitude[0])
        if impulse <= IMPULSE_RATIO * self._withstood.get(event.body.number, 0.0):
            return False
        self._withstood[event.body.number] = impulse
        return True


def fragment_as_shape(fragment: Fragment, name: str, whole: Shape) -> Shape:
    """A fragment of `whole` in a frame of its own; `Shape.to_user` still leads to the user's file."""
    own = normalise(fragment.mesh, name)
    centre = whole.to_user(own.centre)
    return replace(own, scale=own.scale * whole.scale, centre=centre, size=own.scale, whole=whole)


def impact_to_fragment(impact: Impact, fragment: Shape) -> Impact:
    """An impact in the frame of the whole, converted to the fragment's own: I / s^3 at R / s."""
    size = fragment.size
    return Impact(
        (impact.position - _box_centre(fragment)) / size,
        impact.direction,
        impact.magnitude / size**3,
        impact.normal,
        impact.speed,
        impact.radius / size,
    )


def fragments_to_whole(fragments: Fragments, parent: Shape, source: Ints) -> Fragments:
    """The fragments of a fragment, converted to the frame of the whole; `source` of the parent's faces in the whole."""
    return Fragments(tuple(_to_whole(fragment, parent.size, _box_centre(parent), source) for fragment in fragments))


def _to_whole(fragment: Fragment, size: float, centre: Floats, source: Ints) -> Fragment:
    cracked = fragment.source < 0
    return Fragment(
        fragment.mesh.moved(size, centre),
        np.where(cracked, -1, source[fragment.source]),
        fragment.mass * size**3,
        fragment.centre * size + centre,
        fragment.inertia * size**5,
    )


def _box_centre(fragment: Shape) -> Floats:
    """Centre of a fragment's box in the frame of the whole."""
    assert fragment.whole is not None
    return (fragment.centre - fragment.whole.centre) / fragment.whole.scale
