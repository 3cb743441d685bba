"""Spectra line by line from the user's HITRAN or HITEMP lists, through RADIS (optional extra `lines`)."""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import os
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from jaxir.io._array_files import SINGLE, load_arrays
from jaxir.io._files import written_whole
from jaxir.io.spectra._hitran import LineFile, check_line_file
from jaxir.io.spectra._k_tables import Spectra
from jaxir.optics.gas import BOLTZMANN
from jaxir.optics.spectrum import Nodes, bin_edges

_TRACE = 1e-6  # RADIS needs some of the species; this much leaves the widths those of air


def line_spectra(
    files: str | os.PathLike | Sequence[str | os.PathLike],
    nodes: Nodes,
    step: float = 0.01,
    truncation: float = 25.0,
    cache: str | os.PathLike | None = None,
    progress: bool = True,
) -> Spectra:
    """Cross-sections of molecules in air from lists of lines; with `tabulate` and `save_k_tables` they become an NPZ.

        nodes = resolved_nodes(MWIR, width=25.0)
        spectra = line_spectra(["02_hitemp.par", "01_hitemp.par"], nodes)
        hottest = GasState(1500.0, 3e4, {"CO2": 0.06, "H2O": 0.07})
        air = slot_atmosphere(spectra, nodes, StandardAtmosphere(0.0, 10e3, 11.5e3), {"CO2": 420e-6}, hottest)
        save_k_tables("gas.npz", KTables(nodes, tabulate(spectra, nodes), air, spectra.provenance))

    and a scene takes what `load_k_tables` reads: `CorrelatedK(read.tables, ...)` as its plume's gas, `read.air` as its
    atmosphere, rendered on `read.nodes`.

    RADIS (Pannier and Laux, JQSRT 222-223, 2019) adds Voigt lines on an even grid, with partition functions of TIPS
    and broadening by the species itself and by air, which stands for all other gases. On a list of CO2's nu3 bands
    made of published constants, means over 25 cm-1 are within 0.1 % of a convolution of the same lines from 296 to
    1000 K, with wings of 100 cm-1.

    A list must hold the lines that matter at the hottest temperature. Of CO2's nu3 bands one cut at 1e-10 of its
    strongest line at 296 K lacks 5 % of the absorption at 1000 K and 26 % at 1500 K: HITEMP or CDSD are for hot gas.

    A spectrum of a state is computed when it is first asked for and then kept in `cache`, so that a run that was
    stopped goes on where it was. Nothing is written beside the lists. RADIS itself writes its settings to ~/radis.json
    when it is first imported.

    Args:
        files: lists in HITRAN's format of 160 characters, unpacked; several of one molecule join.
        nodes: whose bins the spectra are to cover.
        step: of the grid [cm-1]. RADIS refuses steps above the full width of the narrowest line, and bins want 100
            samples or more.
        truncation: distance from a line's centre at which its wing ends [cm-1]; with 25 cm-1 the faintest absorption
            beside a band, 40 cm-1 from its strong lines, is half of that of endless wings.
        cache: folder for spectra; jaxir/lines in the user's cache folder (XDG_CACHE_HOME or ~/.cache) by default.
            It may be deleted at any time.
        progress: show a bar while a list is checked.

    Returns:
        Spectra of each species found in the files.

    Raises:
        ImportError: RADIS is not installed.
        ValueError: no file, a wrong line (names file and line, see `check_line_file`), a step or truncation that is
            not > 0; when a spectrum is computed: a step too coarse for its lines.
    """
    with _quiet():
        radis = _radis()
    for name, value in (("step", step), ("truncation", truncation)):
        if not (np.isfinite(value) and value > 0):
            raise ValueError(f"{name}: got {value}, expected a number > 0 [cm-1]")
    paths = [files] if isinstance(files, (str, os.PathLike)) else list(files)
    if not paths:
        raise ValueError("files: got none, expected at least one list of lines")
    checked = [check_line_file(path, progress) for path in paths]
    intervals = _intervals(nodes)
    wavenumber = np.concatenate([_grid(interval, step) for interval in intervals])
    about = {
        "radis": radis.__version__,
        "step": step,
        "truncation": truncation,
        "files": [f"{file.path.name}, {file.lines} lines, SHA-256 {file.digest}" for file in checked],
    }
    folder = _cache_folder() if cache is None else Path(cache)
    absorbers = {
        species: _Absorber([file for file in checked if file.species == species], intervals, about, folder)
        for species in dict.fromkeys(file.species for file in checked)
    }
    return Spectra(wavenumber, absorbers, json.dumps(about, indent=1))


class _Absorber:
    """Cross-section of one species, through RADIS and the cache."""

    def __init__(self, files: list[LineFile], intervals: list[tuple[float, float]], about: dict[str, Any], cache: Path):
        self.files, self.intervals, self.cache = files, intervals, cache
        self.step, self.truncation = float(about["step"]), float(about["truncation"])
        digests = [file.digest for file in files]
        self.identity = [about["radis"], self.step, self.truncation, digests, intervals]
        self.factories: list[Any] = []

    def __call__(self, temperature: float, pressure: float, mole_fraction: float) -> Float[np.ndarray, " sample"]:
        state = [float(temperature), float(pressure), float(mole_fraction)]
        name = hashlib.sha256(json.dumps([*self.identity, *state]).encode()).hexdigest()
        file = self.cache / f"{name}.npy"
        if not file.exists():
            with _quiet():
                if not self.factories:
                    self.factories = [self._factory(interval) for interval in self.intervals]
                pieces = [
                    self._piece(factory, interval, *state)
                    for factory, interval in zip(self.factories, self.intervals, strict=True)
                ]
            file.parent.mkdir(parents=True, exist_ok=True)
            with written_whole(file) as part, open(part, "wb") as stream:
                np.save(stream, np.concatenate(pieces).astype(np.float32))
        return self._kept(file)

    def _kept(self, file: Path) -> np.ndarray:
        """The spectrum in a file of the cache."""
        value = load_arrays(file)[SINGLE]
        count = sum(_grid(interval, self.step).size for interval in self.intervals)
        if value.dtype != np.float32 or value.shape != (count,) or not np.isfinite(value).all():
            raise ValueError(
                f"{file}: got {value.dtype} of shape {value.shape}, expected a spectrum of {count} finite samples; "
                "delete the file to repeat it"
            )
        return value.astype(np.float64)

    def _factory(self, interval: tuple[float, float]) -> Any:
        """RADIS with the lines of an interval and its surroundings; None if there are none."""
        radis = _radis()
        factory = radis.SpectrumFactory(
            *interval,
            wstep=self.step,
            molecule=self.files[0].species,
            isotope=",".join(str(i) for i in sorted({i for file in self.files for i in file.isotopes})),
            truncation=self.truncation,
            cutoff=0,
            verbose=False,
        )
        try:
            factory.load_databank(
                path=[str(file.path) for file in self.files], format="hitran", parfunc=None, db_use_cached=False
            )
        except radis.misc.warning.EmptyDatabaseError:
            return None
        return factory

    def _piece(
        self, factory: Any, interval: tuple[float, float], temperature: float, pressure: float, mole_fraction: float
    ) -> np.ndarray:
        """Cross-section on the grid of an interval [sample] [m2]."""
        grid, amount = _grid(interval, self.step), max(mole_fraction, _TRACE)
        if factory is None:
            return np.zeros_like(grid)
        try:
            spectrum = factory.eq_spectrum(
                Tgas=temperature, pressure=pressure * 1e-5, mole_fraction=amount, path_length=1.0
            )
        except _radis().misc.warning.AccuracyError as error:
            state = f"{temperature:g} K and {pressure:g} Pa"
            raise ValueError(f"step: got {self.step} cm-1, expected less for lines at {state} ({error})") from error
        wavenumber, absorption = spectrum.get("abscoeff", wunit="cm-1", Iunit="cm-1")
        if not np.allclose(wavenumber[: grid.size], grid, rtol=0, atol=1e-3 * self.step):
            raise RuntimeError(f"RADIS: got a grid from {wavenumber[0]} cm-1, expected one from {grid[0]} cm-1")
        return 100 * absorption[: grid.size] * BOLTZMANN * temperature / (pressure * amount)


def _intervals(nodes: Nodes) -> list[tuple[float, float]]:
    """The bins, neighbours joined."""
    joined: list[tuple[float, float]] = []
    for low, high in np.unique(np.round(np.stack(bin_edges(nodes), axis=1), 6), axis=0).tolist():
        if joined and low <= joined[-1][1]:
            joined[-1] = (joined[-1][0], max(high, joined[-1][1]))
        else:
            joined.append((low, high))
    return joined


def _grid(interval: tuple[float, float], step: float) -> np.ndarray:
    low, high = interval
    return low + step * np.arange(int(np.ceil((high - low) / step - 1e-6)))


def _cache_folder() -> Path:
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "jaxir" / "lines"


def _radis() -> Any:
    try:
        import radis
        import radis.misc.warning
    except ImportError as error:
        raise ImportError('spectra from lists of lines need RADIS: pip install "jaxir[lines]"') from error
    return radis


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Without RADIS's greetings and its warnings.

    It warns of temperatures above 700 K whatever the list, and of fewer than three samples in a width, which a
    distribution of values does not need.
    """
    with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()):
        warnings.simplefilter("ignore")
        yield
