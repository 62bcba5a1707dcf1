"""What each body of a recording is called in the files that we hand on."""

from __future__ import annotations

import re

from deepfracture.types import Recording, Track


def body_names(recording: Recording) -> list[str]:
    """A name of its own for each track, of ASCII letters, digits and underscores, not beginning with a digit.

    A fragment is called after its number: fragment_012, and a fragment of that one fragment_012_003. The numbers are
    those of the files that `write_fragments` makes of the same break. Where several shapes broke, the name of the
    shape leads: pot_fragment_012, and pot_2_fragment_012 of the second pot. Everything else is called after its
    shape, or after its track."""
    fragments = [track for track in recording.tracks if track.kind == "fragment"]
    order = {id(track): k for k, track in enumerate(fragments)}
    shapes = _shapes(fragments)
    taken: set[str] = set()
    names = []
    for track in recording.tracks:
        name = track.name if track.whole is None else track.whole.name
        if track.kind == "fragment":
            name = _fragment(track, order[id(track)], shapes)
        names.append(unused(identifier(name), taken))
    return names


def _shapes(fragments: list[Track]) -> dict[str, str]:
    """What to call the shapes that broke, by the first word of their fragments' names; nothing if it is but one."""
    roots = {t.name.partition(".")[0]: t for t in fragments if "." in t.name}
    taken: set[str] = set()
    return {
        root: unused(identifier(root if track.whole is None else track.whole.name), taken)
        for root, track in roots.items()
        if len(roots) > 1
    }


def _fragment(track: Track, order: int, shapes: dict[str, str]) -> str:
    """Numbered as the world does it, shape0.012.003; by its order in a recording from elsewhere."""
    root, *numbers = track.name.split(".")
    if not numbers or not all(number.isdecimal() for number in numbers):
        numbers = [str(order)]
    words = ["fragment", *(f"{int(number):03d}" for number in numbers)]
    return "_".join([shapes[root], *words] if root in shapes else words)


def identifier(name: str) -> str:
    """The name in ASCII letters, digits and underscores, not beginning with a digit."""
    plain = re.sub(r"[^A-Za-z0-9_]", "_", name)
    return plain if re.match("[A-Za-z_]", plain) else f"_{plain}"


def unused(name: str, taken: set[str]) -> str:
    """The name, with a number if it is taken; it is from now on."""
    number, own = 1, name
    while own in taken:
        number += 1
        own = f"{name}_{number}"
    taken.add(own)
    return own
