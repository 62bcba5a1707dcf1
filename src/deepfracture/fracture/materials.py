"""Whole brittle materials by name, typical values at room temperature.

Mechanics, measured on specimens: `young` [Pa], `poisson`, `density` [kg/m^3], tensile `strength` [Pa], `toughness`
K_Ic [Pa sqrt(m)] and `compressive_factor`. They scatter by some 10 to 50 % between products of one name; the sources
say what kind was meant. Where only a bending strength is known it stands for the tensile one, which is lower by up to
a half, because more of a specimen is under the largest stress.

Models for looks: `variation_spread`, `variation_length` [m] and `roughness` [m]. The spread is the standard deviation
of the logarithm of strength between specimens, 1.28 / m for a Weibull modulus m (Gumbel); that it varies smoothly in
space within one body, over `variation_length`, and that the toughness varies as much, are assumptions. Roughness is
the amplitude of the waviness of crack surfaces where a shape is two metres long: chosen by eye, grains being finer.
"""

from __future__ import annotations

from types import MappingProxyType

from deepfracture.runtime.suggest import did_you_mean
from deepfracture.types import BadInput, Material

_PRESETS = (
    # Soda-lime float glass. EN 572-1: E 70 GPa, ν 0.2 (makers measure 72 GPa and 0.23), 2500 kg/m^3, characteristic
    # bending strength 45 MPa (41 MPa in the mean for weathered panes: Pilkington ATS-129). K_Ic 0.76: Dowling,
    # Mechanical Behavior of Materials, table 8.2. Compressive strength 1 GPa (makers' data sheets). m = 6.
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
    # Earthenware to stoneware, as pots are made of: typical values between porous earthenware (Kilikoglou, Vekinis,
    # Maniatis 1995, Acta Metall. Mater. 43, 2959) and porcelain, below. Compressive over bending strength about ten,
    # as in most dense ceramics (Kingery, Bowen, Uhlmann, Introduction to Ceramics, ch. 15). m = 8.
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
    # 2.2 g/cm^3 at least; K_Ic 1.0 to 1.3: reviewed by Carty & Senapati 1998, J. Am. Ceram. Soc. 81, 3.
    # Compressive strength about 500 MPa. m = 10.
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
    # (dolomitic limestone). E, ν, compressive 100 MPa (limestones: 30 to 250), tensile 8 MPa: Jaeger, Cook,
    # Zimmerman, Fundamentals of Rock Mechanics, ch. 4 to 6. m = 5.
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
    # Cast gypsum plaster, water to plaster 0.7, dry: 69 lb/ft^3 (USG pottery plaster). E 4.5 GPa, ν 0.24, K_Ic 0.14:
    # Vekinis, Ashby, Beaumont 1993, J. Mater. Sci. 28, 3221 (plaster of Paris as a model material for brittle porous
    # solids). Strength 3 MPa in tension (5 to 7 in bending), four times that in compression (10 to 16 MPa). m = 8.
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
        raise BadInput(
            f"no material is called {name!r}; choose from {', '.join(MATERIALS)}{did_you_mean(name, MATERIALS)}"
        )
    return MATERIALS[name]
