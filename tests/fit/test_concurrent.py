"""Two computations side by side: results, settings, errors."""

import threading

import jax
import jax.numpy as jnp
import pytest

from jaxir.fit._concurrent import SETTINGS, side_by_side


def test_two_computations_overlap_and_keep_their_places():
    both = threading.Barrier(2, timeout=60)  # passed by nobody who waits for the other to end
    aside, here = side_by_side(lambda: (both.wait(), "aside")[1], lambda: (both.wait(), "here")[1])
    assert (aside, here) == ("aside", "here")


def settings():
    return {name: getattr(jax.config, f"jax_{name}") for name in SETTINGS}


def test_settings_of_a_with_hold_on_both_threads(precision):
    with jax.default_matmul_precision("highest"), jax.default_device(jax.devices()[-1]):
        inside, found = settings(), side_by_side(settings, settings)
        kinds = side_by_side(lambda: jnp.asarray(1.0).dtype, lambda: jnp.asarray(1.0).dtype)
    assert found == (inside, inside) and inside["default_matmul_precision"] == "highest"
    assert [kind.name for kind in kinds] == [precision] * 2
    assert side_by_side(settings, settings) == (settings(), settings()) != found


def test_errors_come_out_when_both_have_ended():
    ended = []

    def fails(who):
        ended.append(who)
        raise ValueError(who)

    with pytest.raises(ValueError, match="aside"):
        side_by_side(lambda: fails("aside"), lambda: ended.append("here"))
    with pytest.raises(ValueError, match="here"):
        side_by_side(lambda: fails("aside"), lambda: fails("here"))
    assert sorted(ended) == ["aside", "aside", "here", "here"]
