"""A penny crack in a block of finite elements, under tension and shear, against closed forms.

Radius a, remote tension σ across the crack and shear τ along it, in infinite space:

    K_I = 2 σ sqrt(a / π),                                            (Sneddon 1946)
    K_II = 4 τ / (2 - ν) sqrt(a / π) cos φ,  K_III = 4 (1 - ν) τ / (2 - ν) sqrt(a / π) sin φ

(Kassir & Sih 1966; Tada, Paris & Irwin 2000, sec. 24), φ the angle on the front from the shear's direction. At a
distance r behind the front the faces stand apart by (Irwin 1957)

    Δu_n = 8 (1 - ν^2) / E K_I sqrt(r / 2π),  Δu_r the same with K_II,  Δu_t = 8 (1 + ν) / E K_III sqrt(r / 2π).

K is read off the openings where they start.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from deepfracture.fracture.cracked_solid import CrackedSolid
from deepfracture.types import Floats
from deepfracture.validation.report import Curve, Finding, Plot, Report

POISSON = 0.25
WINDOW = (1.5, 0.8)
"""Openings are read from this many cells behind the front, where no face has a corner on it (its diagonal is
1.41), to this share of the radius."""
SECTOR = 0.8
"""K_II is read where cos φ, K_III where sin φ is above this."""
RING = (1.5, 0.5)
"""Stress is read from this many cells around the front to this share of the crack's radius."""
RING_TERMS = 4


@dataclass(frozen=True, eq=False)
class Penny:
    """A block of cells of side 1 and E = 1 with a disc of its middle plane cut, and stress put on."""

    solid: CrackedSolid
    remote: Floats
    """Uncracked stress, shape (6,): xx, yy, zz, yz, xz, xy; the crack's normal is z."""
    middle: Floats
    """Centre of the crack, in cells, shape (3,)."""
    radius: float
    """Of the disc whose area is that of the cut faces [cells]."""

    @property
    def places(self) -> tuple[Floats, Floats]:
        """Distance behind the front [cells] and angle on it, of each cut face."""
        centres = self.solid.cells[self.solid.faces[:, 0]] + 0.5 - self.middle
        return self.radius - np.hypot(centres[:, 0], centres[:, 1]), np.arctan2(centres[:, 1], centres[:, 0])


def penny(radius: float, half: int, remote: Floats) -> Penny:
    """A crack of `radius` cells in a block of (2 half)^3 cells under the `remote` stress (6,)."""
    side = 2 * half
    solid = CrackedSolid.on(np.ones((side, side, side), bool), spacing=1.0, young=1.0, poisson=POISSON, density=1.0)
    middle = np.full(3, float(half))
    away = solid.cells + 0.5 - middle
    below = np.flatnonzero((solid.cells[:, 2] == half - 1) & (np.hypot(away[:, 0], away[:, 1]) < radius))
    beyond = solid.index[tuple((solid.cells[below] + [0, 0, 1]).T)]
    faces = np.column_stack([below, beyond, np.full(len(below), 2)]).astype(np.int64)
    solid.open_faces(faces, np.tile([0.0, 0, 1], (len(faces), 1)))
    field = np.tile(remote, (len(solid.cells), 1))
    solid.advance(field, np.inf)  # to the simulator's own tolerance; a hundredth of it moves K by 0.2 %
    return Penny(solid, remote, middle, float(np.sqrt(len(faces) / np.pi)))


def finite_body(share: float) -> float:
    """K_I in a round bar of radius R over that in infinite space, for `share` = a / R (Tada, Paris & Irwin 2000,
    sec. 27: the stress on the ligament, a polynomial within 1 %)."""
    shape = (2 / np.pi * (1 + share / 2 - 5 / 8 * share**2) + 0.268 * share**3) * np.sqrt(1 - share)
    return float(shape / (1 - share**2) * np.pi / 2)


def infinite_body(normal: float, shear: float, radius: float) -> Floats:
    """K_I, greatest K_II and greatest K_III for remote tension and shear, shape (3,)."""
    root = np.sqrt(radius / np.pi)
    sliding = 4 * shear / (2 - POISSON) * root
    return np.array([2 * normal * root, sliding, (1 - POISSON) * sliding])


def intensities(crack: Penny) -> tuple[Floats, float]:
    """K_I, greatest K_II and greatest K_III, shape (3,), and the front's distance inside the disc's edge [cells].

    For a penny the squared opening is exactly quadratic in the distance from the front: the parabola through
    ours says where the front of the discrete crack is, and its slope there gives K."""
    behind, angle = crack.places
    opening = crack.solid.openings
    radial = opening[:, 0] * np.cos(angle) + opening[:, 1] * np.sin(angle)
    turning = opening[:, 1] * np.cos(angle) - opening[:, 0] * np.sin(angle)
    near = (behind > WINDOW[0]) & (behind < WINDOW[1] * crack.radius)
    ahead, beside = np.abs(np.cos(angle)) > SECTOR, np.abs(np.sin(angle)) > SECTOR
    modes = (
        (near, opening[:, 2], 1.0),
        (near & ahead, radial / np.cos(angle), 1.0),
        (near & beside, turning / -np.sin(angle), 1 - POISSON),
    )
    values, fronts = [], []
    for here, amount, factor in modes:
        parabola = np.polyfit(behind[here], amount[here] ** 2, 2)
        start = min((complex(z).real for z in np.roots(parabola)), key=abs)
        slope = max(0.0, 2 * parabola[0] * start + parabola[1])
        values.append(factor * np.sqrt(2 * np.pi * slope) / (8 * (1 - POISSON**2)))
        fronts.append(start)
    return np.array(values), float(np.mean(fronts))


def kink(stress_intensity: Floats) -> float:
    """Angle [degrees] of the greatest hoop stress of a singular field (K_I, K_II) (Erdogan & Sih 1963)."""
    first, second = stress_intensity[:2]
    if second == 0:
        return 0.0
    return float(np.degrees(2 * np.arctan((first - np.sqrt(first**2 + 8 * second**2)) / (4 * second))))


def ring_intensities(crack: Penny, stress: Floats, front: float) -> Floats:
    """K_I and K_II, shape (2,), that the stress (n, 6) around the front at φ = 0 holds.

    Williams's series (1957; terms r^-1/2 to r) is fitted to the cells of the plane y = 0 on a ring round the
    front: the terms beyond the first are what the crack's size and the remote stress add at this distance."""
    solid = crack.solid
    side = len(solid.index)
    half = side // 2
    plane = stress.reshape(side, side, side, 6)[:, half - 1 : half + 1].mean(axis=1)
    axis = np.arange(side) + 0.5 - half
    x, z = np.meshgrid(axis - (crack.radius - front), axis, indexing="ij")
    r, angle = np.hypot(x, z), np.arctan2(z, x)
    ring = (r > RING[0]) & (r < RING[1] * crack.radius)
    columns = [_williams(r[ring], angle[ring], n) for n in range(1, RING_TERMS + 1)]
    even = np.stack([first.ravel() for first, _ in columns], axis=1)
    odd = np.stack([second.ravel() for n, (_, second) in enumerate(columns, 1) if n != 2], axis=1)  # n = 2: none
    values = np.concatenate([plane[ring][:, c] for c in (0, 2, 4)])
    amounts = np.linalg.lstsq(np.concatenate([even, odd], axis=1), values, rcond=None)[0]
    return np.sqrt(2 * np.pi) * np.array([amounts[0], -amounts[RING_TERMS]])


def _williams(r: Floats, angle: Floats, n: int) -> tuple[Floats, Floats]:
    """Term n of Williams's series: stress xx, zz, xz (3, k) of the opening and of the sliding mode."""
    h, sign = n / 2, (-1) ** n
    cos1, cos3 = np.cos((h - 1) * angle), np.cos((h - 3) * angle)
    sin1, sin3 = np.sin((h - 1) * angle), np.sin((h - 3) * angle)
    opening = np.stack(
        [(2 + h + sign) * cos1 - (h - 1) * cos3, (2 - h - sign) * cos1 + (h - 1) * cos3,
         (h - 1) * sin3 - (h + sign) * sin1]
    )  # fmt: skip
    sliding = np.stack(
        [-(2 + h - sign) * sin1 + (h - 1) * sin3, -(2 - h + sign) * sin1 - (h - 1) * sin3,
         (h - 1) * cos3 - (h - sign) * cos1]
    )  # fmt: skip
    return h * r ** (h - 1) * opening, h * r ** (h - 1) * sliding


def penny_in_tension(radius: float, half: int) -> Report:
    """K_I of a penny crack across a remote tension of one."""
    crack = penny(radius, half, uniaxial(0.0))
    ours, _ = intensities(crack)
    exact = infinite_body(1.0, 0.0, crack.radius)[0] * finite_body(crack.radius / half)
    behind, _ = crack.places
    # Sneddon 1946
    r = np.linspace(0, crack.radius, 100)
    profile = 8 * (1 - POISSON**2) / np.pi * np.sqrt(2 * crack.radius * r - r**2) * finite_body(crack.radius / half)
    plot = Plot(
        "penny-opening",
        f"Penny crack of {radius:g} cells in a block of {2 * half}",
        "distance behind the front [cells]",
        "opening x E / σ [cells]",
        (Curve("ours", behind, crack.solid.openings[:, 2], "."), Curve("Sneddon", r, profile, "-")),
    )
    return Report((Finding.relative("penny crack, K_I", exact, ours[0], limit=0.05, n=2 * half),), (plot,))


def uniaxial(slope: float) -> Floats:
    """Tension of one whose direction leans by `slope` degrees from the crack's normal z towards x, shape (6,)."""
    c, s = np.cos(np.radians(slope)), np.sin(np.radians(slope))
    return np.array([s * s, 0, c * c, 0, c * s, 0])


def inclined_penny(radius: float, half: int) -> Report:
    """The three intensities under tension at 45 degrees to the crack, and kink angles from 15 to 75 degrees.

    The stress around the front for other slopes is a sum of two solutions: the problem is linear while the
    faces stay apart."""
    crack, straight = penny(radius, half, uniaxial(45.0)), penny(radius, half, uniaxial(0.0))
    ours, front = intensities(crack)
    exact = infinite_body(0.5, 0.5, crack.radius)
    exact[0] *= finite_body(crack.radius / half)
    findings = [
        Finding.relative(f"penny crack at 45 degrees, K_{mode}", k, mine, limit=0.1, n=2 * half)
        for mode, k, mine in zip(("I", "II", "III"), exact, ours, strict=True)
    ]
    tension = straight.solid.stress()
    shear = 2 * crack.solid.stress() - tension  # 45 degrees: half a tension and half a shear
    slopes = np.arange(15.0, 76.0, 15.0)
    angles = []
    for slope in slopes:
        remote = uniaxial(slope)
        stress = remote[2] * tension + remote[4] * shear + remote
        angles.append(kink(ring_intensities(crack, stress, front)))
    every = np.linspace(0, 90, 91)
    criterion = [_exact_kink(slope, crack.radius) for slope in every]
    wrong = np.abs(np.array(angles) - np.interp(slopes, every, criterion))
    worst = int(wrong.argmax())
    case = f"kink at {slopes[worst]:g} degrees (worst of five) [degrees]"
    true = _exact_kink(float(slopes[worst]), crack.radius)
    findings.append(Finding(case, true, angles[worst], float(wrong[worst]), 5.0, 2 * half))
    plot = Plot(
        "kink-angle",
        "Where an inclined penny crack turns",
        "angle between tension and the crack's normal [degrees]",
        "kink angle [degrees]",
        (Curve("stress around our front", slopes, angles, "o"), Curve("exact K, Erdogan & Sih", every, criterion, "-")),
    )
    return Report(tuple(findings), (plot,))


def _exact_kink(slope: float, radius: float) -> float:
    remote = uniaxial(slope)
    return kink(infinite_body(remote[2], remote[4], radius))
