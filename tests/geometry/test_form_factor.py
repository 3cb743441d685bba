"""Form factors against the catalogue (O3, O4) and against sampling in double precision."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxir.geometry import _form_factor as form_factor

# compiled once, because the operations one by one would each be compiled
disc_above, disc_vector, polygon_form_factor = (
    jax.jit(f) for f in (form_factor.disc_above, form_factor.disc_vector, form_factor.polygon_form_factor)
)

UP = np.array([0.0, 0.0, 1.0])


def disc(h, a, r):
    """Disc of radius r at height h over an element at the origin, axis offset a, facing down."""
    return disc_vector(jnp.zeros(3), jnp.asarray([a, 0.0, h]), jnp.asarray(-UP), jnp.asarray(r))


@pytest.mark.parametrize(
    ("h", "a", "r", "factor"), [(1, 0, 1, 0.5), (1, 1, 1, 0.276393202250), (1, 2, 1, 0.052786404500)]
)
def test_disc_over_a_parallel_element(h, a, r, factor, precision):
    """O3: F = [1 - (a^2 + h^2 - r^2) / sqrt((a^2 + h^2 + r^2)^2 - 4 r^2 a^2)] / 2."""
    got = disc(float(h), float(a), float(r))[2]
    np.testing.assert_allclose(got, factor, rtol=1e-6 if precision == "float32" else 1e-11)


@pytest.mark.parametrize(("h", "a", "r"), [(1e3, 2e3, 1e-2), (1e-3, 0.2, 1.0), (1e-3, 1.5, 1.0), (1.0, 1e-8, 1.0)])
def test_disc_keeps_its_digits(h, a, r):
    """Small, near, on the axis: float32 against the same formula in float64."""
    single = np.asarray(disc(h, a, r))
    with jax.enable_x64(True):
        double = np.asarray(disc(h, a, r))
    np.testing.assert_allclose(single, double, rtol=2e-5, atol=1e-12)


def test_disc_over_a_tilted_element(x64):
    """V . n for a tilted receiver against a quadrature of cos cos / (pi d^2) over the disc."""
    h, a, r = 1.3, 0.7, 0.9
    x, w = np.polynomial.legendre.leggauss(60)
    square, angle = np.meshgrid((x + 1) / 2 * r * r, (np.arange(200) + 0.5) / 200 * 2 * np.pi, indexing="ij")
    point = np.stack(
        [a + np.sqrt(square) * np.cos(angle), np.sqrt(square) * np.sin(angle), np.full(angle.shape, h)], -1
    )
    distance = np.linalg.norm(point, axis=-1, keepdims=True)
    omega = point / distance
    weight = (w / 2)[:, None, None] * omega[..., 2:] * omega / distance**2 * r * r
    vector = weight.sum(axis=0).mean(axis=0)
    np.testing.assert_allclose(disc(h, a, r), vector, rtol=1e-10, atol=1e-15)


def test_second_derivatives_on_the_axis_of_a_disc(x64):
    """With D^2 in a^2, F = [1 - (h^2 - r^2 + a^2) / D] / 2 has the slope -.256 in a^2 at h = 1, r = .5."""
    of_offset = jax.hessian(lambda xy: disc_vector(jnp.zeros(3), jnp.stack([*xy, 1.0]), jnp.asarray(-UP), 0.5)[2])
    np.testing.assert_allclose(of_offset(jnp.zeros(2)), -0.512 * np.eye(2), rtol=1e-12, atol=1e-15)


def test_disc_behind_and_on_its_rim(precision):
    below = disc_vector(jnp.zeros(3), jnp.asarray([0.0, 0.0, 1.0]), jnp.asarray(UP), jnp.asarray(1.0))
    assert np.all(np.asarray(below) == 0)
    over = lambda h, a: disc_vector(jnp.zeros(3), jnp.stack([a, 0 * a, h]), jnp.asarray(-UP), jnp.asarray(1.0))  # noqa: E731
    slopes = jax.jit(jax.jacobian(over, argnums=(0, 1)))
    for h, a in [(0.0, 1.0), (0.0, 0.0), (0.0, 2.0), (-1.0, 0.0), (1.0, 0.0)]:
        slope = slopes(jnp.asarray(h), jnp.asarray(a))
        assert all(np.all(np.isfinite(leaf)) for leaf in slope)


def test_disc_above_the_horizon():
    place = (jnp.zeros(3), jnp.asarray(UP))
    facing = (jnp.asarray([1.0, 0.0, 0.0]), jnp.asarray([-1.0, 0.0, 0.0]), jnp.asarray(0.5))
    assert not disc_above(*place, *facing)
    assert disc_above(*place, jnp.asarray([1.0, 0.0, 0.6]), *facing[1:])
    assert disc_above(*place, jnp.asarray([5.0, 0.0, 0.1]), jnp.asarray(-UP), jnp.asarray(9.0))


SQUARE = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])


def over_unit_square(factor):
    """Mean of a form factor over receivers on a unit square, by Gauss-Legendre in a variable that crowds the edges."""
    x, w = np.polynomial.legendre.leggauss(24)
    s = (x + 1) / 2
    place, weight = s * s * (3 - 2 * s), w / 2 * 6 * s * (1 - s)
    px, py = np.meshgrid(place, place, indexing="ij")
    value = jax.jit(jax.vmap(factor))(jnp.asarray(px.ravel()), jnp.asarray(py.ravel()))
    return float(np.sum(np.outer(weight, weight).ravel() * np.asarray(value)))


def test_facing_squares(x64):
    """O4: unit squares facing at distance 1."""
    corners = jnp.asarray(SQUARE + UP)[::-1]
    got = over_unit_square(lambda x, y: polygon_form_factor(jnp.stack([x, y, 0 * x]), jnp.asarray(UP), corners))
    assert got == pytest.approx(0.199824895698, abs=1e-11)


def test_squares_with_a_common_edge(x64):
    """O4: unit squares at a right angle; half the view of every receiver is cut by nothing but its own horizon."""
    wall = jnp.asarray([[0.0, 0, 0], [0, 1, 0], [0, 1, 1], [0, 0, 1]])
    got = over_unit_square(lambda x, y: polygon_form_factor(jnp.stack([x, y, 0 * x]), jnp.asarray(UP), wall))
    assert got == pytest.approx(0.200043776075, abs=1e-8)


def test_a_wall_cut_by_the_horizon(x64):
    """A wall that goes on below the horizon shines no more and no less than its upper half."""
    point, receiver = jnp.asarray([0.8, 0.4, 0.0]), jnp.asarray(UP)
    wall = np.array([[0.0, 0, 0], [0, 1, 0], [0, 1, 1], [0, 0, 1]])
    deep = np.where(wall[:, 2:] == 0, wall - 2 * UP, wall)
    whole = polygon_form_factor(point, receiver, jnp.asarray(wall))
    np.testing.assert_allclose(polygon_form_factor(point, receiver, jnp.asarray(deep)), whole, rtol=1e-12)
    triangle = jnp.asarray([[0.0, 0, -1], [0, 1, -1], [0, 0.3, 1.0]])
    cut = jnp.asarray([[0.0, 0.15, 0], [0, 0.65, 0], [0, 0.3, 1.0]])
    np.testing.assert_allclose(
        polygon_form_factor(point, receiver, triangle), polygon_form_factor(point, receiver, cut), rtol=1e-12
    )


def test_polygon_behind_or_below_gives_nothing(precision):
    point, receiver = jnp.asarray([0.5, 0.5, 0.0]), jnp.asarray(UP)
    towards, away = jnp.asarray(SQUARE + UP)[::-1], jnp.asarray(SQUARE + UP)
    assert polygon_form_factor(point, receiver, away) == 0
    assert polygon_form_factor(point, -receiver, towards) == 0
    assert polygon_form_factor(point, receiver, jnp.asarray(SQUARE)) == 0
    slope = jax.jit(jax.grad(polygon_form_factor, argnums=2))
    for corners in (towards, away, jnp.asarray(SQUARE), jnp.zeros((4, 3))):
        assert np.all(np.isfinite(slope(point, receiver, corners)))


def test_many_corners_are_a_disc(x64):
    """A polygon of 2000 corners against the disc's closed form."""
    angle = np.linspace(0, 2 * np.pi, 2000, endpoint=False)
    ring = np.stack([0.7 + 0.9 * np.cos(angle), 0.9 * np.sin(angle), np.full(2000, 1.3)], axis=-1)[::-1]
    receiver = np.array([0.3, 0.1, np.sqrt(0.9)])
    got = polygon_form_factor(jnp.zeros(3), jnp.asarray(receiver), jnp.asarray(ring))
    want = float(np.asarray(disc(1.3, 0.7, 0.9)) @ receiver)
    assert float(got) == pytest.approx(want, rel=3e-6)
