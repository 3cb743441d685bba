"""Compiled programs, and what is costly to find, kept on disk, so that a second process finds it there.

JAX can keep every program that XLA compiles in a folder, under a key made from the program itself, the compiler's
version and its options, and does so only where it is told a folder. `import jaxir` tells it one, unless the user has
named one (`jax_compilation_cache_dir`) or the environment variable `JAXIR_CACHE` is 0; any other value of it is the
folder. By default it is `$XDG_CACHE_HOME/jaxir/<jaxlib>-<processor>-<jaxir>`, or `~/.cache` in place of the variable.

Who can write the folder can run code in the process, so it is private (mode 0700), and one of another user is not used.
Other values (`kept`, `keep`), executables of `jaxir._programs` among them, lie in the same folder, under a key that
holds a digest of the package's own files.
Each file begins with the SHA-256 of the rest: one that is cut or damaged is left out and compiled anew. Files are
written whole or not at all; when they are more than `LIMIT` bytes together, those used longest ago are deleted.
"""

from __future__ import annotations

import contextlib
import hashlib
import importlib
import os
import platform
import stat
import sys
import threading
from collections.abc import Iterator
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import jax

from jaxir._version import __version__

VARIABLE = "JAXIR_CACHE"
LIMIT = 2**30
_SUFFIX = ".program"
_DIGEST = hashlib.sha256().digest_size


def compilation_cache() -> str:
    """One line that says where compiled programs are kept on disk, or why they are not."""
    return _STATE[0]


def keeps() -> bool:
    """Whether jaxir has a folder of its own where values can be kept."""
    return bool(_FOLDERS)


def kept(key: str) -> bytes | None:
    """What `keep` was given under the key by this code, in this process or an earlier one; None where it is missing."""
    return _FOLDERS[0].get(_of_this_code() + key) if _FOLDERS else None


def keep(key: str, value: bytes) -> None:
    """Keep a value for later processes, where jaxir keeps its programs; else do nothing."""
    if _FOLDERS:
        _FOLDERS[0].put(_of_this_code() + key, value)


@contextlib.contextmanager
def compiled_anew() -> Iterator[None]:
    """Programs compiled inside by this thread are neither taken from the folder nor kept there by JAX.

    An executable that XLA has read cannot be written again: what it wrote would lack its functions.
    """
    _SKIPS.on = True
    try:
        yield
    finally:
        _SKIPS.on = False


@cache
def _of_this_code() -> str:
    """A digest of the package's code and data."""
    files = sorted(path for path in Path(__file__).parent.rglob("*") if path.suffix in (".py", ".csv"))
    return hashlib.sha256(b"".join(hashlib.sha256(path.read_bytes()).digest() for path in files)).hexdigest()


def _say(why: str) -> None:
    """Note that the cache is off, and say so once on the standard error stream."""
    _STATE[0] = f"compilation cache: off, because {why}"
    print(f"jaxir: {_STATE[0]}", file=sys.stderr)


class _Folder:
    """Files of one folder by key; trouble with them is never an error."""

    def __init__(self, path: Path):
        self._path = path
        self._writes = True

    def get(self, key: str) -> bytes | None:
        """What was kept under the key; None where it is missing or damaged."""
        file = self._file(key)
        try:
            content = file.read_bytes()
            if hashlib.sha256(content[_DIGEST:]).digest() == content[:_DIGEST]:
                os.utime(file)
                return content[_DIGEST:]
            file.unlink()
        except OSError:
            pass
        return None

    def put(self, key: str, value: bytes) -> None:
        """Keep a value, whole or not at all."""
        if not self._writes:
            return
        file = self._file(key)
        part = file.with_suffix(f".{os.getpid()}.part")
        try:
            part.write_bytes(hashlib.sha256(value).digest() + value)
            part.replace(file)
        except OSError as error:
            self._writes = False
            part.unlink(missing_ok=True)
            _say(f"{self._path} cannot be written: {error.strerror}")

    def _file(self, key: str) -> Path:
        return self._path / f"{hashlib.sha256(key.encode()).hexdigest()[:40]}{_SUFFIX}"


class _ForJax:
    """A folder in the manner of JAX's `CacheInterface`."""

    def __init__(self, folder: _Folder):
        self._folder = folder

    def get(self, key: str) -> bytes | None:
        """See `_Folder.get`; nothing inside of `compiled_anew`."""
        return None if getattr(_SKIPS, "on", False) else self._folder.get(key)

    def put(self, key: str, value: bytes) -> None:
        """See `_Folder.put`; nothing inside of `compiled_anew`."""
        if not getattr(_SKIPS, "on", False):
            self._folder.put(key, value)


def _shorten(path: Path) -> None:
    """Delete the files used longest ago until the rest is less than half of `LIMIT`, if all are more than it."""
    files = [(entry.stat().st_mtime, entry.stat().st_size, entry.path) for entry in os.scandir(path)]
    total = sum(size for _, size, _ in files)
    if total <= LIMIT:
        return
    for _, size, name in sorted(files):
        Path(name).unlink(missing_ok=True)
        total -= size
        if total < LIMIT / 2:
            return


def _processor() -> str:
    """The machine and, where Linux tells them, the instruction sets of its processor in short."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        sets = next(line for line in lines if line.startswith(("flags", "Features")))
    except (OSError, StopIteration):
        sets = platform.processor()
    return f"{platform.machine()}-{hashlib.sha256(sets.encode()).hexdigest()[:8]}"


def _default() -> Path:
    base = os.environ.get("XDG_CACHE_HOME") or "~/.cache"
    return Path(base).expanduser() / "jaxir" / f"{version('jaxlib')}-{_processor()}-{__version__.replace(' ', '_')}"


def _decide() -> str:
    wanted = os.environ.get(VARIABLE, "")
    if wanted.lower() in ("0", "false", "off", "no"):
        return f"compilation cache: off, because {VARIABLE} says so"
    named = getattr(jax.config, "jax_compilation_cache_dir", None)
    if named:
        return f"compilation cache: {named}, as jax_compilation_cache_dir says"
    try:
        path = Path(wanted) if wanted else _default()
        path.mkdir(mode=0o700, parents=True, exist_ok=True)
        found = path.stat()
        if hasattr(os, "getuid") and found.st_uid != os.getuid():
            return f"compilation cache: off, because {path} belongs to another user"
        if found.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
            return f"compilation cache: off, because others can write {path}"
        if not os.access(path, os.W_OK | os.X_OK):
            return f"compilation cache: off, because {path} cannot be written"
        _shorten(path)
    except (OSError, RuntimeError, ValueError) as error:
        return f"compilation cache: off, because of {error}"
    try:  # private parts of JAX, whose own files are neither checked nor written whole
        inner: Any = importlib.import_module("jax._src.compilation_cache")

        inner.reset_cache()  # what ran before jaxir was imported has looked for it already
        jax.config.update("jax_compilation_cache_dir", str(path))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0)
        jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)
        folder = _Folder(path)
        inner._cache, inner._cache_initialized = _ForJax(folder), True
        _FOLDERS.append(folder)
    except (ImportError, AttributeError) as error:
        return f"compilation cache: off, because this jax keeps it in another way ({error})"
    return f"compilation cache: {path}, set by jaxir ({VARIABLE}=0 prevents it)"


_SKIPS = threading.local()
_FOLDERS: list[_Folder] = []
_STATE = [_decide()]
