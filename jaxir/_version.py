"""Which version of the package this is."""

from importlib.metadata import PackageNotFoundError, version


def _installed() -> str:
    try:
        return version("jaxir")
    except PackageNotFoundError:  # run from its folder, without an installation
        return "not installed"


__version__ = _installed()
