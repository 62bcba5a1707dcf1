"""Whole brittle materials by name, typical values at room temperature.

Elasticity, density and strength scatter by some 10 to 50 % between products of one name; the
sources say what kind was meant. Roughness is an artistic choice in the frame where a shape is two
metres long; the spread of the strength follows the Weibull modulus m of the material, as the
standard deviation of its logarithm, 1.28 / m (Gumbel).
"""

from __future__ import annotations

from types import MappingProxyType

from deepfracture.types import BadInput, Material

_PRESETS = (
    # Soda-lime float glass. EN 572-1: E 70 GPa, ν 0.2 (0.22 to 0.23 measured), 2500 kg/m^3, characteristic
    # bending strength 45 MPa. K_Ic 0.76: Dowling, Mechanical Behavior of Materials, table 8.2.
    # Compressive strength about 1 GPa: Ashby, Materials Selection in Mechanical Design, app. A. m = 6.
    Material(
        "glass",
        young=70e9,
        poisson=0.22,
        density=2500.0,
        strength=45e6,
        toughness=0.76e6,
        compressive_factor=20.0,
        variation_spread=0.2,
        roughness=0.008,
    ),
    # Earthenware to stoneware, as pots are made of. E 30 to 55 GPa, bending strength 20 to 40 MPa and
    # K_Ic 0.7 to 1.2: fired triaxial clay bodies, Kingery, Bowen, Uhlmann, Introduction to Ceramics, ch. 15.
    # Compressive strength about ten times the bending strength (ibid.). m = 8.
    Material(
        "ceramic",
        young=40e9,
        poisson=0.2,
        density=2200.0,
        strength=28e6,
        toughness=0.9e6,
        compressive_factor=10.0,
        variation_spread=0.16,
        roughness=0.015,
    ),
    # Hard porcelain, unglazed. IEC 60672-3 type C 110: bending strength at least 50 MPa, E at least 60 GPa,
    # 2.2 g/cm^3 at least; K_Ic 1.0 to 1.3: Carty & Senapati 1998, J. Am. Ceram. Soc. 81, 3. m = 10.
    Material(
        "porcelain",
        young=70e9,
        poisson=0.22,
        density=2400.0,
        strength=55e6,
        toughness=1.2e6,
        compressive_factor=9.0,
        variation_spread=0.13,
        roughness=0.01,
    ),
    # Limestone of middling grade, as sculptures and pedestals are made of. K_Ic 1.30: Dowling, table 8.2
    # (dolomitic limestone). E, ν, compressive 100 MPa, tensile 8 MPa: Jaeger, Cook, Zimmerman,
    # Fundamentals of Rock Mechanics, ch. 4 to 6. m = 5.
    Material(
        "stone",
        young=50e9,
        poisson=0.25,
        density=2600.0,
        strength=8e6,
        toughness=1.3e6,
        compressive_factor=12.0,
        variation_spread=0.25,
        roughness=0.025,
    ),
    # Cast gypsum plaster, water to plaster 0.7, dry. E 4.5 GPa, ν 0.24, K_Ic 0.14: Vekinis, Ashby, Beaumont
    # 1993, J. Mater. Sci. 28, 3221 (plaster of Paris as a model brittle material). Strength 3 MPa in
    # tension, four times that in compression. m = 8.
    Material(
        "plaster",
        young=4.5e9,
        poisson=0.24,
        density=1100.0,
        strength=3e6,
        toughness=0.14e6,
        compressive_factor=4.0,
        variation_spread=0.16,
        roughness=0.02,
    ),
    # Normal concrete C30/37. EN 1992-1-1, table 3.1: E_cm 33 GPa, f_ctm 2.9 MPa, f_cm 38 MPa; ν 0.2;
    # 2400 kg/m^3 (EN 1991-1-1). K_Ic 1.19: Dowling, table 8.2. m = 5.
    Material(
        "concrete",
        young=33e9,
        poisson=0.2,
        density=2400.0,
        strength=2.9e6,
        toughness=1.19e6,
        compressive_factor=13.0,
        variation_spread=0.25,
        roughness=0.035,
    ),
)

MATERIALS = MappingProxyType({preset.name: preset for preset in _PRESETS})
"""Every preset by name."""


def material(name: str) -> Material:
    """The preset called `name`. Raises BadInput with the names that exist."""
    if name not in MATERIALS:
        raise BadInput(f"no material is called {name!r}; choose from {', '.join(MATERIALS)}")
    return MATERIALS[name]
