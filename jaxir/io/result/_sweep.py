"""A signature over many aspects that survives being killed: every finished view is a file, written whole."""

from __future__ import annotations

import hashlib
import itertools
import json
import math
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.experimental import multihost_utils
from jax.sharding import Mesh
from jaxtyping import Array, Key

from jaxir._arrays import as_float, float_dtype, is_traced, key_or_default
from jaxir.imaging import (
    Signature,
    Views,
    each_view,
    is_column,
    prepare_views,
    remembering,
    repeats,
    shared_by,
    whole_table,
)
from jaxir.io._array_files import load_arrays
from jaxir.io._files import labels, read_json, remove_parts, written_whole
from jaxir.io.result._way import NODES, WAY, read_nodes, read_way, write_nodes, write_way
from jaxir.optics.spectrum import Band, Nodes, as_bands
from jaxir.scene import Scene
from jaxir.transport import Method

CONDITIONS = "conditions.json"
_VALUES = ("intensity", "standard_error", "truncation", "contrast")
_SPLIT = ("component_intensity", "component_error")
_DAMAGED = "got a damaged file, expected a finished view; delete it to repeat it"


def sweep(
    folder: str | os.PathLike,
    scene: Scene | Callable[..., Scene],
    views: Any,
    bands: Nodes | Band | Sequence[Band],
    *,
    over: Mapping[str, Sequence[float]] | None = None,
    distance: Any = np.inf,
    shape: tuple[int, int] = (128, 128),
    samples: int = 2,
    key: Key[Array, ""] | None = None,
    method: Method | None = None,
    rtol: float | None = None,
    atol: float | None = None,
    max_samples: int = 4096,
    max_seconds: float | None = None,
    devices: Mesh | None = None,
    components: str | None = None,
) -> Signature:
    """As `jaxir.signature`, but each view is written when it is finished, and views already written are not computed.

    Called again after it was killed, it goes on where it stopped: at most the views under way, one of each device, are
    lost. The numbers are those of a sweep in one go. In many processes the first one reads and writes the folder; two
    sweeps must not share one at a time, because each removes the parts of files that a killed one left.

    More than the aspect varies with `over`, say Mach, altitude and throttle: `scene` is then a function of them by
    name, and every combination has a folder of its own in this one. Scenes of one structure are compiled once.

        sweep("table", flight, views, bands, over={"mach": [0.6, 0.9], "altitude": [3e3, 9e3], "throttle": [0.7, 1.0]})

    Args:
        folder: made if it does not exist; one NPZ of each view, `conditions.json`, by which a folder begun under other
            conditions is recognised, and `method.json` and `nodes.npz`, where a method and nodes were chosen.
        scene: as `jaxir.signature`, and so on; with `over` a function that returns it.
        views: more may be added at the end later.
        bands: bands or nodes.
        over: axes by name, with their values; more may be added later.
        distance: from the scene to the sensor [m].
        shape: rows and columns of the images.
        samples: rays per pixel.
        key: random key.
        method: as `jaxir.signature`; one that is chosen is kept in the folder, and serves views that are added, too.
        rtol: as `jaxir.signature`, and so on; a view is written when it keeps to it or gives up.
        atol: as `jaxir.signature`.
        max_samples: as `jaxir.signature`.
        max_seconds: as `jaxir.signature`, of what is left to do, and of each call its own; with `over` of every
            combination. Views that were written when they ended stay as they are.
        devices: as `jaxir.signature`.
        components: as `jaxir.signature`.

    Returns:
        The whole table. With `over` its rows are all views of the first combination, then of the next, the last axis
        fastest, with `Signature.axes` and `Signature.state`; its error budget knows sampling, scattering and nodes.

    Raises:
        ValueError: as `jaxir.signature`; the folder was begun under other conditions or holds a damaged file; the
            folder it is to be made in does not exist; values known only inside jit; axes without values or scenes that
            do not have the same components.
    """
    if over is not None:
        own = {"distance": distance, "shape": shape, "samples": samples, "key": key, "method": method}
        own |= {"rtol": rtol, "atol": atol, "max_samples": max_samples, "max_seconds": max_seconds}
        own |= {"devices": devices, "components": components}
        if isinstance(scene, Scene) or not callable(scene):
            named = ", ".join(over) or "no axis"
            raise ValueError(f"over: got {named} with a {type(scene).__name__}, expected a function of the axes")
        return sweep_states(folder, over, lambda kept, state: sweep(kept, scene(**state), views, bands, **own))
    assert isinstance(scene, Scene)
    if is_traced((scene, views, distance, key, method)):
        raise ValueError("sweep: got traced values (inside jit, grad or vmap), expected a call outside it")
    until = repeats(rtol, atol, samples, max_samples, max_seconds)
    chosen = method is None and until is not None
    kept = read_way(Path(folder)) if chosen else method
    wanted = None if until is None or isinstance(bands, Nodes) else as_bands(bands)
    given = bands if wanted is None else read_nodes(Path(folder))
    asked = prepare_views(
        scene,
        views,
        bands if given is None else given,
        distance=distance,
        shape=shape,
        samples=samples,
        key=key,
        method=kept,
        until=until,
        components=components,
    )
    mesh = shared_by(devices, asked.aspect.shape[0], "views")
    conditions = _conditions(
        scene=scene,
        bands=asked.shared.lit.nodes if wanted is None else np.array(str(wanted)),
        distance=as_float(distance),
        pixels=(shape, samples),
        method=None if chosen else asked.shared.method,
        key=jax.random.key_data(key_or_default(key)),
        **({} if components is None else {"components": components}),
        **({} if until is None else {"tolerance": until._replace(seconds=math.inf)}),  # it may go on for longer
    )
    files = _Folder(Path(folder), asked)
    count = asked.aspect.shape[0]
    there = _from_first(lambda: files.finished(conditions), np.zeros(count, bool))
    for missing, name in ((chosen and kept is None, WAY), (given is None, NODES)):
        if missing and there.any():
            raise ValueError(f"{files.path}: got views without {name}, expected both or none")
    if jax.process_index() == 0:
        if chosen and kept is None:
            write_way(files.path, asked.shared.method)
        if given is None:
            write_nodes(files.path, asked.shared.lit.nodes)
    to_do = np.flatnonzero(~there).astype(np.int32)
    for view, values in each_view(asked, to_do, until, "sweep", mesh):
        if jax.process_index() == 0:
            files.write(view, values)
    empty = tuple(np.zeros((count, *shape), asked.aspect.dtype) for shape in files.shapes)
    table = whole_table(asked, tuple(jnp.asarray(part) for part in _from_first(files.read, empty)))
    return remembering(table, scene, asked)


def sweep_states(
    folder: str | os.PathLike,
    over: Mapping[str, Sequence[float]],
    table_of: Callable[[Path, dict[str, float]], Signature],
) -> Signature:
    """The tables of all combinations of some axes, one below the other; `sweep` with `over` for more than the scene.

    Args:
        folder: made if it does not exist.
        over: axes by name, with their values.
        table_of: the table of a combination, of a folder of its own and its values by axis.

    Raises:
        ValueError: axes without values or with one twice; a folder that cannot be made; what `table_of` raises, with
            the combination; tables of different bands or components.
    """
    axes = {name: np.atleast_1d(np.asarray(values, np.float64)) for name, values in over.items()}
    for name, values in axes.items():
        if is_column(name):
            raise ValueError(f"over: got {name!r}, expected a name that tables do not have")
        if values.ndim != 1 or values.size == 0 or not name.isidentifier():
            raise ValueError(f"over: got {name!r} of shape {values.shape}, expected a name with a list of values")
        if np.unique(as_float(values)).size < values.size:
            raise ValueError(f"over: got {name!r} with a value twice, expected values that differ in {float_dtype()}")
    if not axes:
        raise ValueError("over: got no axis, expected axes by name")

    def make() -> np.ndarray:
        _make(Path(folder))
        return np.zeros(())

    _from_first(make, np.zeros(()))
    named = {name: labels(values.tolist(), 9) for name, values in axes.items()}
    states = [dict(zip(axes, state, strict=True)) for state in itertools.product(*named.values())]
    tables = []
    for state in states:
        name = ",".join(f"{axis}={named[axis][value]}" for axis, value in state.items())
        try:
            tables.append(table_of(Path(folder) / name, state))
        except ValueError as error:
            raise ValueError(f"{name}: {error}") from error
    return joined_tables(tables, states)


def joined_tables(tables: Sequence[Signature], states: Sequence[Mapping[str, float]]) -> Signature:
    """Tables of several states as one, one below the other.

    Args:
        tables: of equal bands and components.
        states: of each table, the values of the same axes by name.

    Raises:
        ValueError: tables of different bands or components.
    """
    kinds = {(table.bands, table.components) for table in tables}
    if len(kinds) != 1:
        raise ValueError(f"tables: got {len(kinds)} kinds of bands and components, expected the same in all states")
    bands, components = kinds.pop()
    rows = [len(table.azimuth) for table in tables]
    shares = [
        table.asked.spectral(False) if table.spectral is None and table.asked is not None else table.spectral
        for table in tables
    ]
    spread = [jnp.broadcast_to(x, (n, len(bands))) for x, n in zip(shares, rows, strict=True) if x is not None]

    def together(name: str) -> Any:
        parts = [getattr(table, name) for table in tables]
        return None if parts[0] is None else jnp.concatenate(parts)

    return Signature(
        azimuth=together("azimuth"),
        elevation=together("elevation"),
        intensity=together("intensity"),
        standard_error=together("standard_error"),
        bands=bands,
        truncation=together("truncation"),
        contrast=together("contrast"),
        spectral=jnp.concatenate(spread) if len(spread) == len(tables) else None,
        components=components,
        parts=together("parts"),
        parts_error=together("parts_error"),
        axes=tuple(states[0]),
        state=as_float(np.repeat([list(state.values()) for state in states], rows, axis=0)),
    )


class _Folder:
    """The files of one sweep."""

    def __init__(self, path: Path, views: Views):
        self.path, self.bands = path, views.shared.lit.nodes.names
        self.aspect = np.asarray(views.aspect)
        self.components = () if views.shared.components is None else views.shared.components.names
        width = len(self.bands)
        split = [(len(self.components), width)] * 2 if self.components else []
        self.shapes = [*[(width,)] * len(_VALUES), *split]  # of the values of a view
        self.names = [*_VALUES, *(_SPLIT if self.components else ())]

    def view(self, index: int) -> Path:
        return self.path / f"view_{index:06d}.npz"

    def finished(self, conditions: dict[str, str]) -> np.ndarray:
        """Which views are there; makes the folder, or makes sure that it was begun under these conditions."""
        _make(self.path)
        file = self.path / CONDITIONS
        for names in (CONDITIONS, "view_*.npz"):
            remove_parts(self.path, names)
        if file.exists():
            begun = _begun(file)
            other = [name for name in {**begun, **conditions} if begun.get(name) != conditions.get(name)]
            if other:
                raise ValueError(
                    f"{self.path}: got a sweep begun with other values of {', '.join(other[:5])}"
                    f"{' and more' if len(other) > 5 else ''}, expected the same or another folder"
                )
        elif any(self.path.glob("view_*.npz")):
            raise ValueError(f"{self.path}: got views without {CONDITIONS}, expected both or none")
        else:
            with written_whole(file) as part:
                part.write_text(json.dumps(conditions, indent=1))
        return np.array([self.view(i).exists() and bool(self._load(i)) for i in range(len(self.aspect))])

    def write(self, index: int, values: Sequence[np.ndarray]) -> None:
        with written_whole(self.view(index)) as part, part.open("wb") as stream:
            azimuth, elevation = self.aspect[index]
            np.savez(
                stream,
                azimuth=azimuth,
                elevation=elevation,
                **dict(zip(self.names, values, strict=True)),
                bands=np.array(self.bands),
                components=np.array(self.components, str),
                unit="W sr-1",
            )
            stream.flush()
            os.fsync(stream.fileno())

    def read(self) -> tuple[np.ndarray, ...]:
        """What `view_intensity` finds of all views [view, ...]."""
        return tuple(np.stack(part) for part in zip(*(self._load(i) for i in range(len(self.aspect))), strict=True))

    def _load(self, index: int) -> list[np.ndarray]:
        file = self.view(index)
        try:
            data = load_arrays(file)
            aspect = np.array([data["azimuth"], data["elevation"]])
            found = [data[name].astype(self.aspect.dtype) for name in self.names]
        except (KeyError, TypeError, ValueError) as error:
            raise ValueError(f"{file}: {_DAMAGED} ({error})") from error
        good = [np.isfinite(part).all() for part in found[:2] + found[3:]] + [(found[1] >= 0).all()]
        whole = [part.shape for part in found] == self.shapes and all(good)
        if not whole or data.get("bands", np.array([])).tolist() != list(self.bands):
            raise ValueError(f"{file}: {_DAMAGED} (with finite values of {', '.join(self.bands)})")
        if not np.array_equal(aspect, self.aspect[index]):
            raise ValueError(
                f"{file}: got the view from {aspect.tolist()} deg, expected that from {self.aspect[index].tolist()}; "
                "views may be added at the end only"
            )
        return found


def _make(folder: Path) -> None:
    """Make a folder unless it is there."""
    if not folder.parent.is_dir():
        raise ValueError(f"{folder}: the folder {folder.parent} does not exist")
    if folder.exists() and not folder.is_dir():
        raise ValueError(f"{folder}: got a file, expected a folder")
    folder.mkdir(exist_ok=True)


def _begun(file: Path) -> dict[str, str]:
    """The conditions under which a sweep was begun."""
    begun = read_json(file, "the conditions of a sweep; use another folder")
    if not isinstance(begun, dict):
        raise ValueError(f"{file}: got a {type(begun).__name__}, expected a table of conditions; use another folder")
    return begun


def _from_first(find: Callable[[], Any], like: Any) -> Any:
    """What the first process finds, in every process; `like` has its shapes."""
    found, error = like, None
    if jax.process_index() == 0:
        try:
            found = find()
        except (OSError, ValueError) as caught:
            error = caught
    good, found = multihost_utils.broadcast_one_to_all((np.asarray(error is None), found))
    if error is not None:
        raise error
    if not good:
        raise ValueError("sweep: the first process refused the folder, expected one that it accepts; see its message")
    return found


def _conditions(**given: Any) -> dict[str, str]:
    """A digest of every array and of the structure of what a sweep depends on, by name."""
    found = {}
    for name, tree in given.items():
        leaves, structure = jax.tree_util.tree_flatten_with_path(tree)
        found[f"{name} (structure)"] = hashlib.sha256(str(structure).encode()).hexdigest()
        for path, leaf in leaves:
            value = np.asarray(leaf)
            whole = f"{value.dtype}{value.shape}".encode() + value.tobytes()
            found[name + jax.tree_util.keystr(path)] = hashlib.sha256(whole).hexdigest()
    return found
