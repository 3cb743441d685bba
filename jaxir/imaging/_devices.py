"""The same function of many items, on one device after another or on all devices of a mesh at once.

Every device works on items of its own and none waits for another inside an item, so loops of unequal length cost
nothing; what is gathered is the results alone. Random numbers belong to the item, so results do not depend on which
device computed them, nor on how many there are.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jax.sharding import Mesh, NamedSharding, PartitionSpec
from jaxtyping import Array, Int
from tqdm import tqdm

AXIS = "devices"


def shared_by(devices: Mesh | None, items: int, what: str) -> Mesh | None:
    """The devices, if they suit the items.

    Args:
        devices: a mesh; its axis may be of any type.
        items: how many there are to share.
        what: what they are, for the message.

    Raises:
        ValueError: the mesh has other axes than the one named `AXIS`, or more devices than there are items.
    """
    if devices is None:
        return None
    if devices.axis_names != (AXIS,):
        raise ValueError(f"devices: got a mesh with the axes {devices.axis_names}, expected the one axis ('{AXIS}',)")
    if devices.size > items:
        raise ValueError(f"devices: got {devices.size} devices for {items} {what}, expected at most one device each")
    return Mesh(devices.devices, (AXIS,))


def is_traced(inputs: Any) -> bool:
    """Whether any value is known only inside a transformation."""
    return any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(inputs))


def over_items(
    function: Callable[[Any, Array], Any],
    inputs: Any,
    items: Int[Array, " item"],
    label: str,
    devices: Mesh | None = None,
) -> Any:
    """`function(inputs, item)` for every item, stacked.

    Args:
        function: of a module, so that it is compiled once.
        inputs: a pytree; its arrays may be traced.
        items: numbers of the items.
        label: of the progress bar.
        devices: of `shared_by`; None for one.

    Returns:
        The results [item, ...]: of one compiled loop where inputs are traced, else of a loop on the host.

    Differentiable in inputs as `function` is.
    """
    if is_traced(inputs):
        if devices is None:
            return lax.map(lambda item: function(inputs, item), items)
        rows = _rows(items, devices.size)
        stacked = lax.map(lambda row: _on_devices(function, inputs, row, devices), rows)
        return jax.tree.map(lambda leaf: leaf.reshape((-1,) + leaf.shape[2:])[: items.shape[0]], stacked)
    if devices is None:
        bar = tqdm(items, desc=label, delay=5, leave=False)
        results = [jax.block_until_ready(function(inputs, item)) for item in bar]
        return _stacked(results)
    parts = [part for _, part in item_by_item(function, inputs, items, label, devices)]
    return jax.tree.map(lambda *leaves: jnp.concatenate(leaves), *parts)


@jax.jit
def _stacked(results: list[Any]) -> Any:
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *results)


def item_by_item(
    function: Callable[[Any, Array], Any],
    inputs: Any,
    items: Int[Array, " item"],
    label: str,
    devices: Mesh | None = None,
) -> Iterator[tuple[Int[Array, " some"], Any]]:
    """As `over_items`, but yields items and results as they are ready: one by one, or one of each device."""
    shared = NamedSharding(devices, PartitionSpec()) if devices is not None else None
    inputs = _placed(inputs, shared)
    count = 1 if devices is None else devices.size
    for start in tqdm(range(0, items.shape[0], count), desc=label, delay=5, leave=False):
        own = items[start : start + count]
        if devices is None:
            result = jax.tree.map(lambda leaf: leaf[None], function(inputs, own[0]))
        else:
            row = _placed(_rows(own, count)[0], shared)
            every = _on_devices(function, inputs, row, devices)
            result = jax.tree.map(lambda leaf, own=own: leaf.addressable_data(0)[: own.shape[0]], every)
        yield own, jax.block_until_ready(result)


def _rows(items: Array, count: int) -> Array:
    """Items [row, device]; the last item fills up the last row."""
    return jnp.pad(items, (0, -items.shape[0] % count), mode="edge").reshape(-1, count)


def _placed(inputs: Any, sharding: NamedSharding | None) -> Any:
    """Inputs on every device; in every process they must be the same."""
    return inputs if sharding is None else eqx.filter_shard(inputs, sharding)


@eqx.filter_jit
def _on_devices(function: Callable[[Any, Array], Any], inputs: Any, row: Array, devices: Mesh) -> Any:
    """One item on each device; results [device, ...], the same in all processes."""
    arrays, rest = eqx.partition(inputs, eqx.is_array)

    def one(arrays: Any, own: Array) -> Any:
        return jax.tree.map(lambda leaf: leaf[None], function(eqx.combine(arrays, rest), own[0]))

    here, shared = PartitionSpec(AXIS), PartitionSpec()
    spread = jax.shard_map(one, mesh=devices, in_specs=(shared, here), out_specs=here, check_vma=False)
    return eqx.filter_shard(spread(arrays, row), NamedSharding(devices, shared))
