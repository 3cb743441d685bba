"""Computations side by side: results, their order, settings, errors."""

import threading

import jax
import jax.numpy as jnp
import pytest

from jaxir import _concurrent
from jaxir._concurrent import SETTINGS, each_of, side_by_side


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


@pytest.fixture
def three(monkeypatch):
    """Three cores, wherever the tests run."""
    monkeypatch.setattr(_concurrent, "cores", lambda: 3)


def test_items_are_done_at_a_time_and_come_in_order(three):
    """The first by itself: what it compiles serves the others."""
    together, begun = threading.Barrier(3, timeout=60), []

    def work(item):
        begun.append(item)
        if item:
            together.wait()
        return 10 * item

    every = each_of(work, range(7))
    assert next(every) == 0 and begun == [0]
    assert list(every) == [10, 20, 30, 40, 50, 60]
    assert list(each_of(work, range(1, 4), ready=True)) == [10, 20, 30]


def test_items_are_not_taken_long_before_their_turn(three):
    taken = []
    every = each_of(lambda item: item, (taken.append(k) or k for k in range(1000)))
    for _ in range(10):
        next(every)
    every.close()
    assert len(taken) < 30


def test_items_are_done_under_the_settings_in_force(three, precision):
    with jax.default_matmul_precision("highest"):
        inside, found = settings(), list(each_of(lambda _: settings(), range(5)))
    assert found == [inside] * 5 != [settings()] * 5


def test_an_item_that_fails_ends_those_after_it(three):
    done = []

    def work(item):
        if item == 4:
            raise ValueError("item 4")
        done.append(item)
        return item

    found = []
    with pytest.raises(ValueError, match="item 4"):
        found.extend(each_of(work, range(1000)))
    assert set(range(4)) <= set(done) and len(done) < 30


def test_other_devices_get_one_item_after_another(monkeypatch):
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    _concurrent.cores.cache_clear()
    try:
        assert _concurrent.cores() == 1
        names = list(each_of(lambda _: threading.current_thread().name, range(3)))
    finally:
        _concurrent.cores.cache_clear()
    assert names == [threading.current_thread().name] * 3
