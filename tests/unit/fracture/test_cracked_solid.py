"""The cracked solid: what finite elements, release waves and pressed faces must do whatever the crack."""

import numpy as np
import pytest

from deepfracture.fracture import cracked_solid
from deepfracture.fracture.cracked_solid import CORNERS, CrackedSolid, cube_stiffness
from deepfracture.fracture.stress import LoadPulse, principal
from deepfracture.types import BadInput, NoSolution

YOUNG, POISSON, DENSITY, SIDE = 4e9, 0.25, 1100.0, 0.05
TENSION = np.array([[1e6, 0, 0, 0, 0, 0]])


def bar(length: int = 20, width: int = 4, *, contact: bool = True) -> CrackedSolid:
    return CrackedSolid.on(
        np.ones((length, width, width), bool), spacing=SIDE, young=YOUNG, poisson=POISSON, density=DENSITY,
        contact=contact,
    )  # fmt: skip


def cut_at(solid: CrackedSolid, x: int, rows: int = 99) -> None:
    """Part the faces between the layers x - 1 and x, up to the given row of y."""
    low = np.flatnonzero((solid.cells[:, 0] == x - 1) & (solid.cells[:, 1] < rows))
    high = solid.index[tuple((solid.cells[low] + [1, 0, 0]).T)]
    faces = np.stack([low, high, np.zeros_like(low)], axis=1)
    solid.open_faces(faces, np.tile([1.0, 0, 0], (len(low), 1)))


def momentum(solid: CrackedSolid) -> np.ndarray:
    return np.einsum(
        "ck,cki->i", np.full(solid.connectivity.shape, DENSITY * SIDE**3 / 8), solid.velocity[solid.connectivity]
    )


def total(solid: CrackedSolid, applied: np.ndarray) -> np.ndarray:
    return np.broadcast_to(applied, (len(solid.cells), 6)) + solid.stress()


def test_a_cube_resists_neither_translation_nor_rotation() -> None:
    stiffness = cube_stiffness(POISSON)
    moves = [np.tile(axis, (8, 1)) for axis in np.eye(3)] + [np.cross(axis, CORNERS) for axis in np.eye(3)]
    assert np.abs(stiffness @ np.array([move.ravel() for move in moves], float).T).max() < 1e-14
    assert (np.linalg.eigvalsh(stiffness)[6:] > 1e-3).all()


def test_a_cube_bends_as_a_beam_does() -> None:
    """u_x = -x y / R with Poisson's sides free: pure bending, against which trilinear cubes are far too stiff."""
    x, y, z = (CORNERS - 0.5).T
    u = np.stack([-x * y, x**2 / 2 + POISSON * (y**2 - z**2) / 2, POISSON * y * z], axis=1)
    energy = 0.5 * u.ravel() @ cube_stiffness(POISSON) @ u.ravel()
    assert energy == pytest.approx(0.5 / 12, rel=1e-9)  # M^2 / (2 E I) of a unit cube at unit curvature


def test_a_bar_cut_through_lets_go_and_its_halves_gain_what_the_tension_gives() -> None:
    solid = bar()
    cut_at(solid, 10)
    step, steps = 2e-6, 5
    for _ in range(steps):
        solid.advance(np.repeat(TENSION, len(solid.cells), axis=0), step)
    left = solid.cells[:, 0] < 10
    weight = np.full((left.sum(), 8), DENSITY * SIDE**3 / 8)
    gained = np.einsum("ck,cki->i", weight, solid.velocity[solid.connectivity[left]])
    area = (4 * SIDE) ** 2
    assert gained[0] == pytest.approx(-1e6 * area * step * steps, rel=0.02)
    assert np.abs(momentum(solid)).max() < 0.01 * abs(gained[0])
    assert solid.openings[:, 0].min() > 0


def test_release_waves_take_their_time() -> None:
    solid = bar(60, 3)
    cut_at(solid, 30)
    speed = np.sqrt(YOUNG / DENSITY)  # of long waves in a bar
    time = 12 * SIDE / speed
    for _ in range(60):
        solid.advance(np.repeat(TENSION, len(solid.cells), axis=0), time / 60)
    sigma = total(solid, TENSION)[:, 0].reshape(60, 9).mean(axis=1) / 1e6
    assert np.abs(sigma[[28, 29, 30, 31]]).max() < 0.15
    assert np.abs(sigma[[8, 9, 50, 51]] - 1).max() < 0.1
    assert 0.2 < sigma[42] < 0.8  # the wave is here


def test_a_ligament_takes_over_the_force() -> None:
    solid = bar(24, 4)
    cut_at(solid, 12, rows=2)
    for _ in range(200):
        solid.advance(np.repeat(TENSION, len(solid.cells), axis=0), 1e-4)
    across = total(solid, TENSION)[:, 0].reshape(24, 4, 4)
    assert abs(across[12, 0].mean()) < 0.15e6  # beside the crack
    assert across[12].mean() == pytest.approx(1e6, rel=0.1)  # the section still carries the whole force
    assert across[2].mean() == pytest.approx(1e6, rel=0.01)
    assert across[12, 2].mean() > 2e6 > across[12, 3].mean()  # most at the tip, and the bar bends about it


def test_pressed_faces_carry_the_pressure_and_open_ones_nothing() -> None:
    pressed, loose = bar(), bar(contact=False)
    for solid in (pressed, loose):
        cut_at(solid, 10)
        for _ in range(20):
            solid.advance(-np.repeat(TENSION, len(solid.cells), axis=0), 2e-5)
    middle = (pressed.cells[:, 0] == 9) | (pressed.cells[:, 0] == 10)
    assert total(pressed, -TENSION)[middle, 0].mean() == pytest.approx(-1e6, rel=0.1)
    assert abs(total(loose, -TENSION)[middle, 0].mean()) < 0.1e6
    assert pressed.openings[:, 0].min() > -1e6 * SIDE / YOUNG  # a quarter of a cell's compression, and waves


def test_parting_half_a_section_keeps_one_body_and_what_it_has_done() -> None:
    solid = bar()
    solid.displacement[:] = np.random.default_rng(0).normal(size=solid.displacement.shape)
    before = solid.displacement[solid.connectivity]
    nodes = len(solid.displacement)
    cut_at(solid, 10, rows=2)
    assert (solid.displacement[solid.connectivity] == before).all()
    assert len(solid.displacement) == nodes + 2 * 5  # the front's own corners stay common
    cut_at(solid, 10)
    assert len(solid.displacement) == nodes + 5 * 5
    cut_at(solid, 10)  # once more changes nothing
    assert len(solid.faces) == 16


def test_nothing_happens_without_cracks_and_nothing_can_be_made_of_nothing() -> None:
    solid = bar()
    solid.advance(np.repeat(TENSION, len(solid.cells), axis=0), 1e-4)
    assert not solid.stress().any()
    with pytest.raises(BadInput, match="at least one cell"):
        CrackedSolid.on(np.zeros((3, 3, 3), bool), spacing=1.0, young=1.0, poisson=0.2, density=1.0)


def test_a_step_that_does_not_converge_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cracked_solid, "MAX_ITERATIONS", 2)
    solid = bar()
    cut_at(solid, 10)
    with pytest.raises(NoSolution, match="did not converge in 2 iterations"):
        solid.advance(np.repeat(TENSION, len(solid.cells), axis=0), 1e-4)


def test_principal_stresses_are_eigenvalues() -> None:
    stress = np.random.default_rng(1).normal(size=(200, 6)) * 1e7
    stress[0], stress[1], stress[2] = 0, [1, 1, 1, 0, 0, 0], [-2, 5, 5, 0, 0, 0]
    full = stress[:, [0, 5, 4, 5, 1, 3, 4, 3, 2]].reshape(-1, 3, 3)
    values, directions = principal(stress)
    exact, vectors = np.linalg.eigh(full)
    assert values == pytest.approx(exact, abs=1e-6)
    assert np.abs(np.einsum("ni,ni->n", directions, vectors[:, :, 2]))[3:] == pytest.approx(1)


def test_the_load_comes_and_goes() -> None:
    load = LoadPulse(1e-3)
    assert [load.factor(t) for t in (0, 5e-4, 1e-3, 1.5e-3, 2e-3, 1.0)] == pytest.approx([0, 0.5, 1, 0.5, 0, 0])
