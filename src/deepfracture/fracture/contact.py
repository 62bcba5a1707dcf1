"""The load of a collision: Hertz contact of a steel ball with the body (Hertz 1882; Johnson 1985).

An `Impact` gives impulses, not masses. Each contact is taken as the compression half of a Hertz
impact that stops an effective mass m = I / v: the ball bounces little off what it breaks. With the
effective modulus E* and the ball's radius R (the body is flat at the contact)

    duration      t = 2.868 (m^2 / (E*^2 R v))^(1/5)            Johnson 1985, eq. 11.24
    compression   δ = (15 m v^2 / (16 E* sqrt R))^(2/5)          Johnson 1985, eq. 11.22
    patch         a = sqrt(R δ)  at the largest force            Johnson 1985, eq. 4.22

and the mean force I / t acts along the impulse.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from deepfracture.geometry import closest_points
from deepfracture.types import BadInput, Floats, Impact, Material, Mesh

STEEL_YOUNG = 210e9
"""Young's modulus of the ball [Pa]."""
STEEL_POISSON = 0.3
BOUNDARY_ELEMENTS = 1500
"""Elements of the uniform boundary mesh whose element is the paper's smallest contact area A_1."""
MIN_PATCH = 2 * 3**-0.75
"""Smallest patch radius in square roots of the local triangle area: the circumradius of an equilateral
triangle. A smaller patch is spread over one element, below which the mesh cannot resolve it."""
SUBDIVISION = 8
"""Sub-triangles along an edge on which the pressure is sampled."""


@dataclass(frozen=True)
class HertzContact:
    """One Hertz impact."""

    duration: float
    """Duration [s]."""
    radius: float
    """Radius of the contact patch at the largest force [m]."""
    force: float
    """Mean force I / duration [N]."""


def effective_modulus(material: Material) -> float:
    """E* [Pa] of a steel ball on a material: 1/E* = (1-ν1^2)/E1 + (1-ν2^2)/E2 (Johnson 1985, eq. 4.5)."""
    body = (1 - material.poisson**2) / material.young
    return 1 / (body + (1 - STEEL_POISSON**2) / STEEL_YOUNG)


def hertz(impulse: float, speed: float, radius: float, material: Material) -> HertzContact:
    """The contact of a steel ball of `radius` [m] that loses `impulse` [N s] at closing `speed` [m/s]."""
    if not (impulse > 0 and speed > 0 and radius > 0):
        raise BadInput(f"impulse, speed and radius must be positive, got {impulse}, {speed} and {radius}")
    modulus = effective_modulus(material)
    mass = impulse / speed
    duration = 2.868 * (mass**2 / (modulus**2 * radius * speed)) ** 0.2
    compression = (15 * mass * speed**2 / (16 * modulus * radius**0.5)) ** 0.4
    return HertzContact(duration, (radius * compression) ** 0.5, impulse / duration)


def contacts(impact: Impact, material: Material) -> tuple[HertzContact, ...]:
    """The Hertz contact of each impulse, strongest first; all at the closing speed of the strongest."""
    return tuple(hertz(float(i), impact.speed, impact.radius, material) for i in impact.magnitude)


def tractions(impact: Impact, material: Material, mesh: Mesh) -> Floats:
    """Traction [Pa] on each triangle of `mesh`, shape (nt, 3), while the contacts last.

    Each contact spreads its mean force with a Hertz pressure profile over its patch, on triangles that
    face the striker (a thin wall's far side stays free); the total is exact. Contacts add.
    """
    areas = np.linalg.norm(mesh.area_vectors, axis=1)
    total = np.zeros((len(mesh.faces), 3))
    for index, contact in enumerate(contacts(impact, material)):
        fractions = _force_fractions(mesh, impact.position[index], impact.normal[index], contact.radius)
        force = contact.force * impact.direction[index]
        total += (fractions / areas)[:, None] * force
    return total


def element_area(surface_area: float) -> float:
    """Area of a triangle of a uniform boundary mesh [m^2]: one measure for every tessellation."""
    return surface_area / BOUNDARY_ELEMENTS


def critical_stress(impact: Impact, material: Material, surface_area: float) -> float:
    """The paper's σ_1 = I_1 d_1.n_1 / (A_1 Δt) [Pa] of the strongest contact; zero where it pulls.

    Δt is the Hertz contact time. A_1 is the Hertz patch, or one element of a uniform boundary mesh over
    `surface_area` [m^2] where that is larger, so that the tessellation of the shape does not matter.
    """
    if not surface_area > 0:
        raise BadInput(f"surface_area must be positive, got {surface_area}")
    strongest = contacts(impact, material)[0]
    # The direction points into the body, the normal out of it.
    pressing = max(0.0, -float(impact.direction[0] @ impact.normal[0]))
    area = max(np.pi * strongest.radius**2, element_area(surface_area))
    return strongest.force * pressing / area


def breaks(impact: Impact, material: Material, surface_area: float) -> bool:
    """The paper's criterion σ_1 > σ_0: whether the collision starts a crack."""
    return critical_stress(impact, material, surface_area) > material.strength


def _force_fractions(mesh: Mesh, position: Floats, normal: Floats, radius: float) -> Floats:
    """Fraction of the force on each triangle, shape (nt,); they add up to one."""
    area_vectors = mesh.area_vectors
    facing = np.flatnonzero(area_vectors @ normal > 0)
    if not len(facing):
        raise BadInput(f"no triangle faces the contact normal {normal}; is it the outward normal?")
    near = closest_points(Mesh(mesh.vertices, mesh.faces[facing]), position[None])
    centre, nearest = near.points[0], facing[int(near.faces[0])]
    areas = np.linalg.norm(area_vectors, axis=1)
    radius = max(radius, MIN_PATCH * float(areas[nearest]) ** 0.5)
    weights = _barycentric_samples(SUBDIVISION)
    corners = mesh.triangles[facing]
    reachable = np.linalg.norm(corners - centre, axis=2).min(axis=1) < radius + _longest_edge(corners)
    facing, corners = facing[reachable], corners[reachable]
    samples = np.einsum("sa,nai->nsi", weights, corners)
    fraction2 = ((samples - centre) ** 2).sum(axis=2) / radius**2
    pressure = np.sqrt(np.maximum(0.0, 1 - fraction2)).mean(axis=1)  # Hertz: p ~ sqrt(1 - (r/a)^2)
    fractions = np.zeros(len(mesh.faces))
    fractions[facing] = pressure * areas[facing]
    if not fractions.any():  # a patch between the samples of large, uneven triangles
        fractions[nearest] = 1.0
    return fractions / fractions.sum()


def _longest_edge(corners: Floats) -> Floats:
    return np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2).max(axis=1)


def _barycentric_samples(count: int) -> Floats:
    """Centres of the count^2 sub-triangles of a triangle in barycentric coordinates, (count^2, 3)."""
    upright = [(i + 1 / 3, j + 1 / 3) for i in range(count) for j in range(count - i)]
    inverted = [(i + 2 / 3, j + 2 / 3) for i in range(count - 1) for j in range(count - 1 - i)]
    first = np.array(upright + inverted) / count
    return np.column_stack([first, 1 - first.sum(axis=1)])
