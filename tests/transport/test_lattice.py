"""The two pieces that the lattice of scattered light rests on: sums of what rays read, and the linear solver."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

import jaxir
from jaxir.transport.ordinates._collected import collected
from jaxir.transport.ordinates._krylov import solved
from jaxir.transport.ordinates._lattice import _cubic


@pytest.mark.parametrize(
    "cells, expected",
    [((1, 1, 1), (9, 9, 9)), ((4, 4, 4), (10, 10, 10)), ((24, 6, 6), (11, 9, 9)), ((3, 2, 1), (9, 10, 9))],
)
def test_few_points_lie_on_sides_of_cells(cells, expected):
    plume = jaxir.GridPlume(jaxir.Grid((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), cells), 600.0, jaxir.GrayGas(1.0))
    medium = jaxir.Scene(None, plume).on(jaxir.gray_nodes((jaxir.MWIR,))).medium
    assert medium.lattice(9, 9) == expected


def _reading(seed=0):
    """Four rays of three steps that read two pairs each of a table of five rows; one step has no shares."""
    random = np.random.default_rng(seed)
    place = jnp.asarray(random.integers(0, 4, (4, 3, 2)), jnp.int32)
    share, passed, lobe, table = (
        random.uniform(0.1, 1, shape) for shape in ((4, 3, 2, 2), (4, 3, 6), (4, 3), (5, 3, 6))
    )
    share[2, 1] = 0
    return place, *(jnp.asarray(x) for x in (share, passed, lobe, table))


def test_what_rays_read_is_the_sum_it_says(x64):
    place, share, passed, lobe, table = _reading()
    read = np.asarray(table)[np.asarray(place)[..., None] + np.arange(2)]
    expected = np.einsum("rsn,rh,rskj,rskjhn->rn", passed, lobe, share, read)
    np.testing.assert_allclose(collected(place, share, passed, lobe, table), expected, rtol=1e-13)
    both = jax.vmap(collected, (None, None, None, None, 0))(place, share, passed, lobe, jnp.stack([table, 2 * table]))
    np.testing.assert_allclose(both, np.stack([expected, 2 * expected]), rtol=1e-13)


@pytest.mark.parametrize("backend", ["cpu", "gpu"])
def test_what_rays_read_is_the_same_in_the_order_of_a_graphics_card(x64, monkeypatch, backend):
    place, share, passed, lobe, table = _reading(1)
    expected, pull = jax.vjp(lambda table: collected(place, share, passed, lobe, table), table)
    monkeypatch.setattr(jax, "default_backend", lambda: backend)
    again = [jnp.concatenate([x, x]) for x in (place, share, passed, lobe)]  # of another shape: compiled anew
    both, pull_both = jax.vjp(lambda table: collected(*again, table), table)
    np.testing.assert_allclose(both, jnp.concatenate([expected, expected]), rtol=1e-13)
    np.testing.assert_allclose(pull_both(both)[0], 2 * pull(expected)[0], rtol=1e-13)


def test_what_rays_read_is_differentiable_in_all_but_the_place(x64):
    """To second order, because solutions of the table's own equation are differentiated, too."""
    place, *others = _reading()
    function = lambda *x: jnp.sin(collected(place, *map(jnp.asarray, x)))  # noqa: E731
    check_grads(function, others, order=2, modes=["fwd", "rev"], rtol=1e-4)


def _system(nodes=3, unknowns=12, seed=0):
    """Contractions of each node [node, unknown, unknown], and a right side [unknown, node]."""
    random = np.random.default_rng(seed)
    matrix = random.normal(size=(nodes, unknowns, unknowns))
    shares = np.array([0.2, 0.9, 0.99])[:nodes]  # the largest singular value: how much is scattered
    matrix *= (shares / np.linalg.norm(matrix, 2, axis=(1, 2)))[:, None, None]
    return jnp.asarray(matrix), jnp.asarray(random.normal(size=(unknowns, nodes)))


def _solution(matrix, begin):
    return solved(lambda x: jnp.einsum("nij,jn->in", matrix, x), begin, 1e-10, 200)


def test_the_equation_of_each_node_is_solved(x64):
    matrix, begin = _system()
    found, residual = _solution(matrix, begin)
    each = [np.linalg.solve(np.eye(12) - m, b) for m, b in zip(np.asarray(matrix), np.asarray(begin).T, strict=True)]
    np.testing.assert_allclose(found, np.stack(each, axis=1), rtol=1e-7, atol=1e-8)
    assert float(residual) <= 1e-10
    nothing, lacking = _solution(matrix, 0 * begin)
    assert not np.asarray(nothing).any() and float(lacking) == 0


def test_steps_that_are_too_few_are_told(x64):
    matrix, begin = _system()
    found, residual = solved(lambda x: jnp.einsum("nij,jn->in", matrix, x), begin, 1e-10, 3)
    left = begin - found + jnp.einsum("nij,jn->in", matrix, found)
    rms = jnp.sqrt(jnp.sum(left**2, axis=0) / jnp.sum(begin**2, axis=0)).max()
    assert float(residual) == pytest.approx(float(rms), rel=1e-9) and 1e-10 < float(residual) < 1


def test_solutions_are_differentiable(x64):
    check_grads(lambda *x: _solution(*map(jnp.asarray, x))[0], _system(), order=1, modes=["fwd", "rev"], rtol=1e-5)


def test_sums_along_a_ray_err_by_the_fourth_power_of_the_spacing(x64):
    """Over the top of a bell, read by straight lines; between its own values they err by the second power."""

    def error(count):
        inside = 0.25 + (np.arange(4000) + 0.5) / 8000
        read = _cubic(count) @ np.exp(-10 * (np.linspace(0, 1, count) - 0.5) ** 2)
        seen = np.interp(inside, np.linspace(0, 1, len(read)), read).mean()
        return abs(seen / np.exp(-10 * (inside - 0.5) ** 2).mean() - 1)

    assert error(9) < 1e-3 and error(17) < error(9) / 12
