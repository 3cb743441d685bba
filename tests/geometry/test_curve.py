"""A curve that fills a square."""

import jax.numpy as jnp
import numpy as np

from jaxir.geometry import hilbert_index


def test_the_curve_visits_every_cell_once_and_goes_from_neighbour_to_neighbour():
    bits = 6
    x, y = (jnp.asarray(c.ravel(), jnp.int32) for c in np.indices((2**bits, 2**bits)))
    place = np.asarray(hilbert_index(x, y, bits))
    assert np.array_equal(np.sort(place), np.arange(4**bits))
    path = np.stack([x, y], axis=1)[np.argsort(place)]
    assert (np.abs(np.diff(path, axis=0)).sum(axis=1) == 1).all()
    assert tuple(path[0]) == (0, 0) and tuple(path[-1]) == (2**bits - 1, 0)
    for apart in (7, 60, 500):
        assert (np.square(path[apart:] - path[:-apart]).sum(axis=1) <= 6 * apart).all()
