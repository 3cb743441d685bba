"""The same function of many items, on one device or on all devices of a mesh at once.

Every device works on items of its own and none waits for another inside an item, so loops of unequal length cost
nothing; what is gathered is the results alone. Random numbers belong to the item, so results do not depend on which
device computed them, nor on how many there are.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.sharding import Mesh, NamedSharding, PartitionSpec
from jaxtyping import Int
from tqdm import tqdm

from jaxir._arrays import is_traced, placed
from jaxir._concurrent import each_of
from jaxir._fields import require_part
from jaxir._programs import of_items, program

AXIS = "devices"


def shared_by(devices: Any, items: int, what: str) -> Mesh | None:
    """The devices, if they suit the items.

    Args:
        devices: a mesh; its axis may be of any type.
        items: how many there are to share.
        what: what they are, for the message.

    Raises:
        ValueError: no mesh, one with other axes than the one named `AXIS`, or with more devices than there are items.
    """
    if devices is None:
        return None
    require_part("devices", devices, Mesh, f"a mesh of devices, e.g. jax.make_mesh((2,), ('{AXIS}',))")
    if devices.axis_names != (AXIS,):
        raise ValueError(f"devices: got a mesh with the axes {devices.axis_names}, expected the one axis ('{AXIS}',)")
    if devices.size > items:
        raise ValueError(f"devices: got {devices.size} devices for {items} {what}, expected at most one device each")
    return Mesh(devices.devices, (AXIS,))


def stacked(
    function: Callable[[Any, Any], Any],
    inputs: Any,
    items: Any,
    label: str,
    devices: Mesh | None = None,
) -> Any:
    """The results [item, ...] of `function(inputs, item)` for every item.

    Args:
        function: of a module, so that it is compiled once.
        inputs: a pytree; its arrays may be traced.
        items: a pytree of arrays [item, ...]; may be traced.
        label: of the progress bar.
        devices: of `shared_by`; None for one.

    Returns:
        The results: of one program where inputs are traced, which is compiled once for each structure; else of a loop
        on the host, which compiles nothing anew for another number of items.

    Differentiable in inputs and items as the function is.
    """
    if is_traced((inputs, items)):
        return _in_one_program(function, inputs, jax.tree.map(placed, items), devices)
    join = np.stack if devices is None else np.concatenate
    found = item_by_item(function, inputs, jax.tree.map(np.asarray, items), label, devices)
    every = [result for _, result in found]
    return jax.tree.map(lambda *leaves: placed(join([np.asarray(leaf) for leaf in leaves])), *every)


def _count(items: Any) -> int:
    return jax.tree.leaves(items)[0].shape[0]


@program
def _in_one_program(
    function: Callable[[Any, Any], Any],
    inputs: Any,
    items: Any,
    devices: Mesh | None,
) -> Any:
    if devices is None:
        return lax.map(lambda item: function(inputs, item), items)
    count = _count(items)
    rows = jnp.asarray(_rows(np.arange(count), devices.size))
    every = lax.map(lambda row: _on_devices(function, inputs, _at(items, row), devices), rows)
    return jax.tree.map(lambda leaf: leaf.reshape((-1,) + leaf.shape[2:])[:count], every)


def item_by_item(
    function: Callable[[Any, Any], Any],
    inputs: Any,
    items: Any,
    label: str,
    devices: Mesh | None = None,
) -> Iterator[tuple[Int[np.ndarray, " some"], Any]]:
    """Places of items and results of `function(inputs, item)` as they are ready.

    One by one with the result of one, or with `devices` one of each and the results stacked [item, ...].

    Args:
        function: as in `stacked`, and so on.
        inputs: a pytree.
        items: a pytree of arrays of numpy [item, ...].
        label: of the progress bar.
        devices: of `shared_by`; None for one.
    """
    count = _count(items)
    if devices is None:
        of = of_items(function, inputs)
        with progress(label, count) as done:
            every = each_of(lambda place: jax.block_until_ready(of(_at(items, place))), range(count))
            for place, result in enumerate(every):
                yield np.asarray([place]), result
                done(1)
        return
    shared = NamedSharding(devices, PartitionSpec())
    inputs = eqx.filter_shard(inputs, shared)  # in every process they must be the same
    with progress(label, count) as done:
        for row in _rows(np.arange(count), devices.size):
            given = eqx.filter_shard(jax.tree.map(placed, _at(items, row)), shared)
            every = _on_devices(function, inputs, given, devices)
            own = np.unique(row)
            result = jax.tree.map(lambda leaf, own=own: leaf.addressable_data(0)[: own.size], every)
            yield own, jax.block_until_ready(result)
            done(own.size)


def _at(items: Any, place: Any) -> Any:
    """The item at a place, or those at some."""
    return jax.tree.map(lambda leaf: leaf[place], items)


@contextlib.contextmanager
def progress(label: str, count: int) -> Iterator[Callable[[int], None]]:
    """A bar for what takes more than 5 s; the first step, which compiles what is new, counts in no estimate."""
    with tqdm(total=count, desc=f"{label}: compiling, once for scenes of this structure", delay=5, leave=False) as bar:

        def done(steps: int) -> None:
            if bar.n == 0:
                bar.set_description(label, refresh=False)
                bar.initial, bar.start_t = steps, time.time()
            bar.update(steps)

        yield done


def _rows(items: np.ndarray, count: int) -> np.ndarray:
    """Items [row, device]; the last item fills up the last row."""
    return np.pad(items, (0, -items.shape[0] % count), mode="edge").reshape(-1, count)


@program
def _on_devices(function: Callable[[Any, Any], Any], inputs: Any, row: Any, devices: Mesh) -> Any:
    """One item on each device; results [device, ...], the same in all processes."""
    arrays, rest = eqx.partition(inputs, eqx.is_array)

    def one(arrays: Any, own: Any) -> Any:
        return jax.tree.map(lambda leaf: leaf[None], function(eqx.combine(arrays, rest), _at(own, 0)))

    here, shared = PartitionSpec(AXIS), PartitionSpec()
    spread = jax.shard_map(one, mesh=devices, in_specs=(shared, here), out_specs=here, check_vma=False)
    return eqx.filter_shard(spread(arrays, row), NamedSharding(devices, shared))
