"""Composition of exhaust gas."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxir._arrays import Check, as_float, enforce

NITROGEN_PER_OXYGEN = 3.7738  # air: 20.947 % O2, argon and the rest counted as N2


class Products(NamedTuple):
    """Mole fractions of a gas, each [*cell]."""

    h2o: Float[Array, "*cell"]
    co2: Float[Array, "*cell"]
    o2: Float[Array, "*cell"]
    n2: Float[Array, "*cell"]


def combustion_products(carbon: float, hydrogen: float, equivalence_ratio: Any) -> Products:
    """Products of the complete combustion of a hydrocarbon in dry air.

        C_x H_y + (a / phi) (O2 + 3.7738 N2) -> x CO2 + y/2 H2O + a (1 / phi - 1) O2 + 3.7738 a / phi N2

    with a = x + y/4. Below phi = 1 and 2000 K this is the equilibrium composition but for traces. Mixed with air the
    products are those of a smaller equivalence ratio: phi may be a field, 0 is pure air. `NarrowBandGas` takes the
    fractions `h2o`, `co2`, `o2`.

    Args:
        carbon: x, atoms of carbon in the molecule, >= 0.
        hydrogen: y, atoms of hydrogen, >= 0; kerosene is about C12 H23, n-pentane C5 H12.
        equivalence_ratio: phi in [0, 1], [*cell].

    Returns:
        Mole fractions, which sum to 1.

    Raises:
        ValueError: no atoms to burn, or phi outside [0, 1].

    Differentiable in `equivalence_ratio`.
    """
    if not (carbon >= 0 and hydrogen >= 0 and carbon + hydrogen > 0):
        raise ValueError(f"carbon, hydrogen: got {carbon}, {hydrogen}, expected numbers of atoms >= 0, not both 0")
    phi = as_float(equivalence_ratio, "equivalence_ratio")
    lean = (phi >= 0) & (phi <= 1)
    phi = enforce(phi, [Check("equivalence_ratio", phi, lean, "values in [0, 1]: rich mixtures leave CO and H2")])
    oxygen = carbon + hydrogen / 4
    h2o, co2 = phi * (hydrogen / 2), phi * carbon
    o2 = oxygen * (1 - phi)
    n2 = jnp.full_like(phi, NITROGEN_PER_OXYGEN * oxygen)
    total = h2o + co2 + o2 + n2
    return Products(h2o / total, co2 / total, o2 / total, n2 / total)
