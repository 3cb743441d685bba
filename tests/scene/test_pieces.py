"""The pieces of a plume by which it is drawn as a light: directions towards them have their density."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from chi_square import direction_grid, p_value

import jaxir
from jaxir.geometry import Independent, pdf_pieces, sample_pieces, sight_of
from jaxir.optics.spectrum import gray_nodes
from jaxir.scene.plume import PlumeSum

NODES = gray_nodes((jaxir.LWIR,))
HOT = 700.0

# hotter at one corner, around the point; a jet beside it
RAMP = jaxir.GridPlume(
    jaxir.Grid((-0.6, -0.9, -0.4), (0.2, 0.25, 0.3), (5, 7, 3)),
    300 + 500 * np.linspace(0, 1, 105).reshape(5, 7, 3),
    jaxir.GrayGas(0.5),
)
JET = jaxir.JetPlume((-0.4, 0.1, 0.3), (1.0, -0.2, 0.4), 0.15, HOT, 300.0, jaxir.GrayGas(2.0), length=12.0)


@pytest.mark.parametrize("plume", [RAMP, JET, PlumeSum((RAMP, JET))], ids=["grid", "jet", "both"])
def test_directions_towards_a_plume_have_their_density(plume):
    """Which is positive wherever the plume is above the horizon."""
    point = jnp.asarray([0.1, 0.0, 0.0])

    @jax.jit
    def prepared(omega):
        pieces = plume.pieces(jaxir.PlumeLight().exponent)
        endless = jnp.full(omega.shape[:1], jnp.inf, omega.dtype)
        glow = jaxir.Scene(plumes=plume).on(NODES).emission(jnp.broadcast_to(point, omega.shape), omega, endless)
        return pieces, sight_of(pieces, point, jnp.asarray([0.0, 0.0, 1.0])), glow[:, 0]

    omega = direction_grid()[0].reshape(-1, 3)
    pieces, sight, glow = prepared(jnp.asarray(omega))

    def sample(u):
        own = jax.random.fold_in(jax.random.key(1), jax.lax.bitcast_convert_type(u[0], jnp.uint32))
        return sample_pieces(pieces, sight, lambda k: Independent().draw(jax.random.fold_in(own, k), 1))[0]

    density = jax.jit(jax.vmap(partial(pdf_pieces, pieces, sight)))
    fit, total = p_value(sample, partial(pdf_pieces, pieces, sight), np.eye(3), jax.random.key(2))
    assert fit > 1e-3
    assert abs(total - 1) < 0.01
    shines = (np.asarray(glow) > 0) & (omega[:, 2] > 0)
    assert shines.sum() > 100
    assert np.all(np.asarray(density(jnp.asarray(omega)))[shines] > 0)
