import jax
import numpy as np

from jaxir._arrays import as_float
from jaxir.geometry import inside_cone, view_from_axis


@jax.jit
@jax.vmap
def interval(origin, direction, flare):
    view = view_from_axis(*(as_float(x) for x in ([0.2, 0.1, -0.3], [0.0, 0.6, 0.8], 5.0)), origin, direction)
    low, high = inside_cone(view, as_float(0.7), flare, as_float(5.0))
    return view.start + low, view.start + high


def test_interval_equals_a_search_along_the_ray(x64):
    rng = np.random.default_rng(0)
    count, base, axis = 600, np.array([0.2, 0.1, -0.3]), np.array([0.0, 0.6, 0.8])
    direction = rng.normal(size=(count, 3))
    direction[: count // 2] = axis * rng.choice([-1, 1], (count // 2, 1)) + 0.15 * direction[: count // 2]
    direction[:20] = axis
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    through = base + rng.uniform(-1, 6, (count, 1)) * axis + rng.normal(size=(count, 3)) * 0.6
    origin = through - rng.uniform(0, 8, (count, 1)) * direction
    flare = rng.choice([0.25, -0.14], count)
    low, high = (np.asarray(x) for x in interval(*(as_float(x) for x in (origin, direction, flare))))
    t = np.linspace(-20, 40, 6001)
    offset = origin[:, None] + t[:, None] * direction[:, None] - base
    z = offset @ axis
    r = np.linalg.norm(offset - z[..., None] * axis, axis=-1)
    inside = (z >= 0) & (z <= 5) & (r <= 0.7 + flare[:, None] * z)
    found = inside.sum(axis=1) > 1
    assert 100 < found.sum() < count - 100
    first, last = t[inside.argmax(axis=1)], t[t.size - 1 - inside[:, ::-1].argmax(axis=1)]
    np.testing.assert_allclose(low[found], first[found], atol=0.0101)
    np.testing.assert_allclose(high[found], last[found], atol=0.0101)
    missed = ~found
    assert (high[missed] - low[missed] < 0.021).all()
