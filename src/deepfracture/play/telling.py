"""What the page says: the physics of a shot, what its stages took, how to train a model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from html import escape

from deepfracture.play.library import Entry
from deepfracture.play.session import Readout

STAGES = {
    "predict": "predict",
    "segment": "segment",
    "prepare fragment": "prepare the piece",
    "elastostatics": "stress",
    "cracks": "cracks",
    "fragments": "fragments",
    "restrict": "restrict to the piece",
    "cut": "cut",
    "put in": "hulls, put in",
}
"""Stages of a break that the page tells, of all that are measured: the others are parts of these."""
COLLISIONS = 60
"""That `deepfracture simulate` throws."""
TRAINING = "6 to 10 minutes"
"""What `deepfracture train` takes on two cores with that many patterns."""


@dataclass(frozen=True)
class Timing:
    """When a click led to what, by `time.perf_counter()` [s]; None: it did not, or not yet."""

    click: float | None = None
    thrown: float | None = None
    """The ball was in the world."""
    struck: float | None = None
    """The step began in which it broke something ..."""
    broke: float | None = None
    """... and ended, with the fragments in the world."""
    moving: float | None = None
    """Fragments that have moved were on their way to the browser."""
    frame: int = 0
    """The first with fragments."""
    milliseconds: Mapping[str, float] = field(default_factory=dict)
    """Of the stages of the break."""

    def rows(self) -> list[tuple[str, float]]:
        """What is worth telling, with milliseconds."""
        if self.click is None or self.struck is None or self.broke is None or self.moving is None:
            return []
        rows = [("flight of the ball", 1e3 * (self.struck - self.click))]
        rows += [(f"– {said}", self.milliseconds[name]) for name, said in STAGES.items() if name in self.milliseconds]
        rows += [("break, all in all", 1e3 * (self.broke - self.struck))]
        rows += [("to the browser", 1e3 * (self.moving - self.broke))]
        return [*rows, ("click to first moving fragment", 1e3 * (self.moving - self.click))]


def readout_html(found: Readout | None, timing: Timing, *, flying: bool = False) -> str:
    """What the last shot did."""
    if found is None:
        said = "The ball is on its way." if flying else "Nothing hit yet." if timing.click is None else "Missed."
        return _page(f"<div class='df-note'>{said}</div>")
    share = found.stress / found.strength
    verdict = f"{found.fragments} fragments" if found.fragments else "it held"
    rows = [
        ("impulse I", f"{found.impulse:,.0f} N s"),
        ("stress σ₁", f"{found.stress / 1e6:,.1f} MPa"),
        ("strength σ₀", f"{found.strength / 1e6:,.1f} MPa"),
        ("σ₁ / σ₀", f"{share:,.2f} {'&gt;' if share > 1 else '≤'} 1"),
        ("pieces in the world", f"{found.pieces}"),
    ]
    table = "".join(f"<tr><td>{name}</td><td>{value}</td></tr>" for name, value in rows)
    bar = f"<div class='df-bar'><div style='width:{min(share, 1.0) * 100:.0f}%'></div></div>"
    clock = "".join(
        f"<tr{' class=df-sum' if name.startswith(('click', 'break')) else ''}><td>{escape(name)}</td>"
        f"<td>{value:,.0f} ms</td></tr>"
        for name, value in timing.rows()
    )
    return _page(
        f"<div class='df-big'>{verdict}</div>{bar}<table>{table}</table>" + (f"<table>{clock}</table>" if clock else "")
    )


STYLE = """<style>
.df { padding: 0 0.9em 0.6em; font-size: 0.82em; line-height: 1.45 }
.df table { width: 100%; border-collapse: collapse; margin-top: 0.5em }
.df td { padding: 0.05em 0 } .df td + td { text-align: right; font-variant-numeric: tabular-nums }
.df tr.df-sum td { font-weight: 600 }
.df-big { font-size: 1.7em; font-weight: 650; color: #bd5e3d; line-height: 1.2 }
.df-bar { height: 5px; background: #eee7e0; border-radius: 3px; margin: 0.35em 0 } .df-bar div { height: 5px;
background: #bd5e3d; border-radius: 3px }
.df-note { color: #777 } .df code { font-size: 0.92em; background: #f4f0ec; padding: 0 0.25em; border-radius: 3px;
overflow-wrap: anywhere } .df-wrong { color: #b02a1a; font-weight: 600 }
.df-busy { color: #bd5e3d; font-weight: 600 }
</style>"""


def _page(inner: str) -> str:
    return f"{STYLE}<div class='df'>{inner}</div>"


def status_html(text: str, kind: str = "") -> str:
    """A line on how things are, or the instructions when all is well."""
    if text:
        return _page(f"<div class='df-{kind or 'busy'}'>{escape(text)}</div>")
    return _page(
        "<b>Click the object</b> to shoot at it, and its pieces again.<br>"
        "<span class='df-note'>Drag turns the view, the wheel zooms, right drag moves.</span>"
    )


def breaker_html(entry: Entry, breaker: str, material: str) -> str:
    """What breaks the shape now, and what it would take to do better."""
    if breaker == "learned":
        note = "The trained model of this shape answers in a tenth of a second."
        if material != "plaster":
            note += f" Its cracks are those of plaster; whether they start depends on {material}."
        return _page(f"<div class='df-note'>{note}</div>")
    if breaker == "physical":
        note = "Boundary elements and growing cracks: a break takes a few seconds."
    else:
        note = "Voronoi cells: quick, not physical."
    if entry.model is None:
        note += f" There is no trained model of {escape(entry.label)}. {training(entry)}"
    return _page(f"<div class='df-note'>{note}</div>")


def training(entry: Entry) -> str:
    """How to get a model, in HTML, and how long that takes."""
    name = escape(entry.label) if entry.file is None else "my_mesh" + (entry.file.suffix)
    mend = " --repair" if entry.repair else ""
    return (
        f"Train one and it breaks at once: <code>deepfracture simulate {name}{mend} --out data/mine</code> "
        f"({COLLISIONS} collisions, 2 to 5 minutes), <code>deepfracture train data/mine --out runs/mine</code> "
        f"({TRAINING}), <code>deepfracture play {name} --model runs/mine/model.safetensors</code>."
    )
