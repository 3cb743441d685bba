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
from jaxtyping import Array, Int
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


def over_items(
    function: Callable[[Any, Array], Any],
    whole: Callable[[Any, Any], Any],
    inputs: Any,
    items: Int[np.ndarray, " item"],
    label: str,
    devices: Mesh | None = None,
    quick: bool = False,
) -> Any:
    """`whole(inputs, results)` of the results of `function(inputs, item)` for every item.

    Args:
        function: of a module, so that it is compiled once.
        whole: of a module, too; results come stacked [item, ...].
        inputs: a pytree; its arrays may be traced.
        items: numbers of the items.
        label: of the progress bar.
        devices: of `shared_by`; None for one.
        quick: whether all items together take no longer than a few calls.

    Returns:
        What `whole` makes: of one program where inputs are traced, which is compiled once for each structure, or on one
        device all is quick; else of a loop on the host.

    Differentiable in inputs as the two functions are.
    """
    if is_traced(inputs):
        return _in_one_program(function, whole, inputs, placed(items), devices)
    if quick and devices is None:
        with progress(label, 1):
            return _in_one_program(function, whole, inputs, placed(items), None)
    results = [part for _, part in item_by_item(function, inputs, items, label, devices)]
    return _joined(whole, inputs, results, devices is not None)


@program
def _in_one_program(
    function: Callable[[Any, Array], Any],
    whole: Callable[[Any, Any], Any],
    inputs: Any,
    items: Int[Array, " item"],
    devices: Mesh | None,
) -> Any:
    if devices is None:
        return whole(inputs, lax.map(lambda item: function(inputs, item), items))
    rows = jnp.asarray(_rows(np.arange(items.shape[0]), devices.size))
    stacked = lax.map(lambda row: _on_devices(function, inputs, items[row], devices), rows)
    return whole(inputs, jax.tree.map(lambda leaf: leaf.reshape((-1,) + leaf.shape[2:])[: items.shape[0]], stacked))


@program
def _joined(whole: Callable[[Any, Any], Any], inputs: Any, results: list[Any], rows: bool) -> Any:
    join = jnp.concatenate if rows else jnp.stack
    return whole(inputs, jax.tree.map(lambda *leaves: join(leaves), *results))


def item_by_item(
    function: Callable[[Any, Array], Any],
    inputs: Any,
    items: Int[np.ndarray, " item"],
    label: str,
    devices: Mesh | None = None,
) -> Iterator[tuple[Int[np.ndarray, " some"], Any]]:
    """Items and results of `function(inputs, item)` as they are ready.

    One by one with the result of one, or with `devices` one of each and the results stacked [item, ...].
    """
    if devices is None:
        of = of_items(function, inputs)
        with progress(label, len(items)) as done:
            every = each_of(lambda item: jax.block_until_ready(of(item)), items)
            for item, result in zip(items, every, strict=True):
                yield np.asarray([item]), result
                done(1)
        return
    shared = NamedSharding(devices, PartitionSpec())
    inputs = eqx.filter_shard(inputs, shared)  # in every process they must be the same
    with progress(label, len(items)) as done:
        for start in range(0, items.shape[0], devices.size):
            own = items[start : start + devices.size]
            row = eqx.filter_shard(placed(_rows(own, devices.size)[0]), shared)
            every = _on_devices(function, inputs, row, devices)
            result = jax.tree.map(lambda leaf, own=own: leaf.addressable_data(0)[: own.shape[0]], every)
            yield own, jax.block_until_ready(result)
            done(len(own))


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
def _on_devices(function: Callable[[Any, Array], Any], inputs: Any, row: Array, devices: Mesh) -> Any:
    """One item on each device; results [device, ...], the same in all processes."""
    arrays, rest = eqx.partition(inputs, eqx.is_array)

    def one(arrays: Any, own: Array) -> Any:
        return jax.tree.map(lambda leaf: leaf[None], function(eqx.combine(arrays, rest), own[0]))

    here, shared = PartitionSpec(AXIS), PartitionSpec()
    spread = jax.shard_map(one, mesh=devices, in_specs=(shared, here), out_specs=here, check_vma=False)
    return eqx.filter_shard(spread(arrays, row), NamedSharding(devices, shared))
