"""Text of the page: the physics of a shot, the times of its stages, how to train a model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from html import escape

from deepfracture.play.library import Entry
from deepfracture.play.session import Readout

STAGES = {
    "predict": "predict",
    "segment": "segment",
    "prepare fragment": "prepare the fragment",
    "elastostatics": "stress",
    "cracks": "cracks",
    "fragments": "fragments",
    "restrict": "restrict to the fragment",
    "cut": "cut",
    "put in": "collision hulls, replacement",
}
"""Stages of a break that the page lists; the others are parts of these."""
COLLISIONS = 60
"""Default of `deepfracture simulate`."""
TRAINING = "6 to 10 minutes"
"""Time of `deepfracture train` on two cores with that many patterns."""


@dataclass(frozen=True)
class Timing:
    """When the effects of a click happened, by `time.perf_counter()` [s]; None: not yet, or never."""

    click: float | None = None
    thrown: float | None = None
    """The ball entered the world."""
    struck: float | None = None
    """The step in which it broke something began ..."""
    broke: float | None = None
    """... and ended, with the fragments in the world."""
    moving: float | None = None
    """Moved fragments were sent to the browser."""
    frame: int = 0
    """The first with fragments."""
    milliseconds: Mapping[str, float] = field(default_factory=dict)
    """Of the stages of the break."""

    def rows(self) -> list[tuple[str, float]]:
        """Labels and durations [ms]."""
        if self.click is None or self.struck is None or self.broke is None or self.moving is None:
            return []
        rows = [("flight of the ball", 1e3 * (self.struck - self.click))]
        rows += [(f"– {label}", self.milliseconds[name]) for name, label in STAGES.items() if name in self.milliseconds]
        rows += [("break, total", 1e3 * (self.broke - self.struck))]
        rows += [("to the browser", 1e3 * (self.moving - self.broke))]
        return [*rows, ("click to first moving fragment", 1e3 * (self.moving - self.click))]


def readout_html(found: Readout | None, timing: Timing, *, flying: bool = False) -> str:
    """The result of the last shot."""
    if found is None:
        text = "The ball is on its way." if flying else "Nothing hit yet." if timing.click is None else "Missed."
        return _page(f"<div class='df-note'>{text}</div>")
    share = found.stress / found.strength
    verdict = f"{found.fragments} fragments" if found.fragments else "did not break"
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
    """A status line; the instructions if `text` is empty."""
    if text:
        return _page(f"<div class='df-{kind or 'busy'}'>{escape(text)}</div>")
    return _page(
        "<b>Click the object</b> to throw a ball at it; click its pieces to break them again.<br>"
        "<span class='df-note'>Drag to rotate, scroll to zoom, right-drag to pan.</span>"
    )


def breaker_html(entry: Entry, breaker: str, material: str) -> str:
    """Describes the breaker, and how to train a model if the shape has none."""
    if breaker == "learned":
        note = "The trained model of this shape answers in a tenth of a second."
        if material != "plaster":
            note += f" Its cracks are those of plaster; {material} only decides whether it breaks."
        return _page(f"<div class='df-note'>{note}</div>")
    if breaker == "physical":
        note = "Boundary elements and crack growth: a break takes a few seconds."
    else:
        note = "Voronoi cells: fast, not physical."
    if entry.model is None:
        note += f" There is no trained model of {escape(entry.label)}. {training(entry)}"
    return _page(f"<div class='df-note'>{note}</div>")


def training(entry: Entry) -> str:
    """The commands that train a model, as HTML, and how long they take."""
    name = escape(entry.label) if entry.file is None else "my_mesh" + (entry.file.suffix)
    repair = " --repair" if entry.repair else ""
    return (
        f"With one it breaks at once: <code>deepfracture simulate {name}{repair} --out data/mine</code> "
        f"({COLLISIONS} collisions, 2 to 5 minutes), <code>deepfracture train data/mine --out runs/mine</code> "
        f"({TRAINING}), <code>deepfracture play {name} --model runs/mine/model.safetensors</code>."
    )
