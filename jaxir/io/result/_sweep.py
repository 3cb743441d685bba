"""A signature over many aspects that survives being killed: every finished view is a file, written whole."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.experimental import multihost_utils
from jax.sharding import Mesh
from jaxtyping import Array, Key

from jaxir._arrays import as_float, key_or_default
from jaxir.imaging import (
    Signature,
    Views,
    is_traced,
    item_by_item,
    prepare_views,
    remembering,
    shared_by,
    view_intensity,
    whole_table,
)
from jaxir.io._array_files import load_arrays
from jaxir.io._files import read_text, remove_parts, written_whole
from jaxir.optics.spectrum import Band, Nodes
from jaxir.scene import Scene
from jaxir.transport import Method

CONDITIONS = "conditions.json"
_VALUES = ("intensity", "standard_error", "truncation")
_DAMAGED = "got a damaged file, expected a finished view; delete it to repeat it"


def sweep(
    folder: str | os.PathLike,
    scene: Scene,
    views: Any,
    bands: Nodes | Band | Sequence[Band],
    *,
    distance: Any = np.inf,
    shape: tuple[int, int] = (128, 128),
    samples: int = 2,
    key: Key[Array, ""] | None = None,
    method: Method | None = None,
    devices: Mesh | None = None,
) -> Signature:
    """As `jaxir.signature`, but each view is written when it is finished, and views already written are not computed.

    Called again after it was killed, it goes on where it stopped: at most the views under way, one of each device, are
    lost. The numbers are those of a sweep in one go. In many processes the first one reads and writes the folder; two
    sweeps must not share one at a time, because each removes the parts of files that a killed one left.

    Args:
        folder: made if it does not exist; one NPZ of each view, and `conditions.json`, by which a folder begun under
            other conditions is recognised.
        scene: as `jaxir.signature`, and so on.
        views: more may be added at the end later.
        bands: bands or nodes.
        distance: from the scene to the sensor [m].
        shape: rows and columns of the images.
        samples: rays per pixel.
        key: random key.
        method: as `jaxir.render`.
        devices: as `jaxir.signature`.

    Returns:
        The whole table.

    Raises:
        ValueError: as `jaxir.signature`; the folder was begun under other conditions or holds a damaged file; the
            folder it is to be made in does not exist; values known only inside jit.
    """
    if is_traced((scene, views, distance, key, method)):
        raise ValueError("sweep: got values known only inside jit, expected a call outside it")
    asked = prepare_views(
        scene,
        views,
        bands,
        distance=distance,
        shape=shape,
        samples=samples,
        key=key,
        method=Method() if method is None else method,
    )
    mesh = shared_by(devices, asked.aspect.shape[0], "views")
    conditions = _conditions(
        scene=scene,
        bands=asked.lit.nodes,
        distance=as_float(distance),
        pixels=(shape, samples),
        method=asked.method,
        key=jax.random.key_data(key_or_default(key)),
    )
    files = _Folder(Path(folder), asked)
    count, width = asked.aspect.shape[0], asked.lit.nodes.response.shape[0]
    there = _from_first(lambda: files.finished(conditions), np.zeros(count, bool))
    to_do = np.flatnonzero(~there).astype(np.int32)
    for index, found in item_by_item(view_intensity, asked, to_do, "sweep", mesh):
        if jax.process_index() == 0:
            rows = (np.asarray(part).reshape(index.size, width) for part in found)
            for place, *values in zip(index.tolist(), *rows, strict=True):
                files.write(place, *values)
    empty = np.zeros((3, count, width), asked.aspect.dtype)
    return remembering(whole_table(asked, tuple(jnp.asarray(_from_first(files.read, empty)))), scene, asked)


class _Folder:
    """The files of one sweep."""

    def __init__(self, path: Path, views: Views):
        self.path, self.bands = path, views.lit.nodes.names
        self.aspect = np.asarray(views.aspect)

    def view(self, index: int) -> Path:
        return self.path / f"view_{index:06d}.npz"

    def finished(self, conditions: dict[str, str]) -> np.ndarray:
        """Which views are there; makes the folder, or makes sure that it was begun under these conditions."""
        if not self.path.parent.is_dir():
            raise ValueError(f"{self.path}: the folder {self.path.parent} does not exist")
        self.path.mkdir(exist_ok=True)
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
        return np.array([self.view(i).exists() and self._load(i).size > 0 for i in range(len(self.aspect))])

    def write(self, index: int, intensity: np.ndarray, error: np.ndarray, truncation: np.ndarray) -> None:
        with written_whole(self.view(index)) as part, part.open("wb") as stream:
            azimuth, elevation = self.aspect[index]
            np.savez(
                stream,
                azimuth=azimuth,
                elevation=elevation,
                intensity=intensity,
                standard_error=error,
                truncation=truncation,
                bands=np.array(self.bands),
                unit="W sr-1",
            )
            stream.flush()
            os.fsync(stream.fileno())

    def read(self) -> np.ndarray:
        """Intensity, standard error and truncation share of all views [3, view, band]."""
        return np.stack([self._load(index) for index in range(len(self.aspect))], axis=1)

    def _load(self, index: int) -> np.ndarray:
        file = self.view(index)
        try:
            data = load_arrays(file)
            aspect = np.array([data["azimuth"], data["elevation"]])
            found = np.stack([data[name].astype(self.aspect.dtype) for name in _VALUES])
        except (KeyError, TypeError, ValueError) as error:
            raise ValueError(f"{file}: {_DAMAGED} ({error})") from error
        whole = found.shape[1:] == (len(self.bands),) and np.isfinite(found[:2]).all() and (found[1] >= 0).all()
        if not whole or data.get("bands", np.array([])).tolist() != list(self.bands):
            raise ValueError(f"{file}: {_DAMAGED} (with finite values of {', '.join(self.bands)})")
        if not np.array_equal(aspect, self.aspect[index]):
            raise ValueError(
                f"{file}: got the view from {aspect.tolist()} deg, expected that from {self.aspect[index].tolist()}; "
                "views may be added at the end only"
            )
        return found


def _begun(file: Path) -> dict[str, str]:
    """The conditions under which a sweep was begun."""
    try:
        begun = json.loads(read_text(file))
    except (ValueError, RecursionError) as error:
        said = str(error) if str(error).startswith(f"{file}:") else f"{file}: {error}"
        raise ValueError(f"{said}, expected the conditions of a sweep; use another folder") from error
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
