import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import chi2

from jaxir._arrays import enforce
from jaxir.optics.particle import HenyeyGreenstein, Isotropic, TabulatedPhase

ANGLE = np.linspace(np.pi, 0, 181)
PHASES = {
    "isotropic": lambda: Isotropic(),
    "forward": lambda: HenyeyGreenstein([0.8, 0.3]),
    "backward": lambda: HenyeyGreenstein(-0.5),
    "none": lambda: HenyeyGreenstein(0.0),
    "table": lambda: TabulatedPhase(np.cos(ANGLE), np.stack([1 + np.cos(ANGLE) ** 2, np.exp(3 * np.cos(ANGLE))])),
    "table with zeros": lambda: TabulatedPhase([-1.0, -0.5, 0.0, 0.5, 1.0], [0.0, 0.0, 1.0, 0.0, 2.0]),
}


@pytest.fixture(params=PHASES)
def phase(request):
    return PHASES[request.param]()


def test_integrates_to_one_and_samples_follow_the_density(phase):
    edges = np.linspace(-1, 1, 41)
    middle = (np.linspace(-1, 1, 4001)[1:] + np.linspace(-1, 1, 4001)[:-1]) / 2
    count = 20000
    u = (np.arange(count) + np.random.default_rng(1).random(count)) / count

    @jax.jit
    def every(phase, cosine, u):
        return jax.vmap(phase.eval)(cosine), jax.vmap(phase.pdf)(cosine), jax.vmap(phase.sample)(u)

    found = every(phase, jnp.asarray(middle, np.float32), jnp.asarray(u, np.float32))
    value, density, drawn = map(np.asarray, found)
    assert np.allclose(2 * np.pi * value.mean(axis=0) * 2, 1, rtol=2e-3)
    assert np.allclose(density, value.mean(axis=1), rtol=1e-5, atol=1e-7)
    assert drawn.min() >= -1 and drawn.max() <= 1
    expected = 2 * np.pi * density.reshape(40, -1).mean(axis=1) * 0.05 * count
    found = np.histogram(drawn, edges)[0]
    held = expected > 5
    assert found[~held].sum() < 30
    # stratified numbers scatter less than independent ones
    assert np.sum((found - expected)[held] ** 2 / expected[held]) < chi2.ppf(0.999, held.sum())


def test_mean_cosine_of_henyey_and_greenstein():
    point, weight = np.polynomial.legendre.leggauss(200)
    phase = HenyeyGreenstein([0.7, -0.2])
    value = np.asarray(jax.jit(jax.vmap(phase.eval))(jnp.asarray(point, np.float32)))
    assert np.allclose(2 * np.pi * (weight * point) @ value, [0.7, -0.2], atol=1e-4)


@jax.jit
def every_way(a):
    """Values of Henyey and Greenstein's, and slopes in their asymmetry by both modes."""

    def value(a):
        return jax.vmap(HenyeyGreenstein(a).eval)(jnp.asarray([-1.0, -0.3, 0.8, 1.0]))[:, 0]

    return value(a), jax.jacfwd(value)(a), jax.jacrev(value)(a)


@pytest.mark.parametrize("asymmetry", [0.0, 0.6, -0.6])
def test_slope_in_the_asymmetry_of_henyey_and_greenstein(asymmetry, x64):
    """At 0 it is that of (1 + 3 a cos) / (4 pi), whatever the sign of a small step."""

    value, *modes = every_way(asymmetry)
    after, before = (np.asarray(every_way(asymmetry + step)[0]) for step in (1e-6, -1e-6))
    assert not np.array_equal(after, value)
    for slope in modes:
        np.testing.assert_allclose(slope, (after - before) / 2e-6, rtol=1e-8)


def test_extreme_values_and_gradients_are_finite(phase, precision):
    phase = jax.tree.map(lambda leaf: jnp.asarray(np.asarray(leaf), precision), phase)
    slopes = jax.vmap(jax.grad(lambda p, at: p.eval(at).sum(), argnums=(0, 1)), in_axes=(None, 0))
    both = jax.jit(lambda phase, at, u: (slopes(phase, at), jax.vmap(phase.sample)(u)))
    at, u = (jnp.asarray(x, precision) for x in ([-1.0, 0.0, 1.0], [0.0, 0.5, 1 - 6e-8]))
    found, drawn = both(phase, at, u)
    for leaf in jax.tree.leaves(found):
        assert np.isfinite(leaf).all()
    assert np.all(np.abs(drawn) <= 1)


@pytest.mark.parametrize(
    ("make", "what"),
    [
        (lambda: TabulatedPhase([-1.0, 1.0], [[1.0, 2.0, 3.0]]), "got shape"),
        (lambda: TabulatedPhase([1.0], [1.0]), "at least 2"),
        (lambda: TabulatedPhase([-1.0, 0.5, 0.2, 1.0], np.ones(4)), "cosine: got .* expected increasing finite values"),
        (lambda: TabulatedPhase([-1.0, 0.0, 0.9], np.ones(3)), "from -1 to 1"),
        (lambda: TabulatedPhase([-1.0, 0.0, 1.0], [1.0, -0.1, 1.0]), ">= 0"),
        (lambda: TabulatedPhase([-1.0, 1.0], [0.0, 0.0]), "sum over angles: got 0.0"),
        (lambda: HenyeyGreenstein(1.0), "inside"),
        (lambda: HenyeyGreenstein([[0.1]]), "got shape"),
    ],
)
def test_bad_tables_are_refused(make, what):
    with pytest.raises(ValueError, match=what):
        enforce(jnp.zeros(1), make().checks())
