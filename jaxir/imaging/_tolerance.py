"""What is asked of intensities and images, and what they may cost."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from jaxir._arrays import float_dtype
from jaxir._fields import require_count
from jaxir.imaging._image import Image

LEAST = 8  # units of the last place: a relative tolerance below is beyond the precision in force
FIRST = 1 / 3  # of the error asked for, at which a first look is the answer: few rays tell their own error poorly


class Tolerance(NamedTuple):
    """What is asked of the intensities of a view or an image.

    Attributes:
        rtol: standard error as a share of the intensity.
        atol: standard error that is good enough for any intensity [W sr-1].
    """

    rtol: float
    atol: float

    def __str__(self) -> str:
        """Those of the two that are asked."""
        return " or ".join([f"{self.rtol:.2g}"] * (self.rtol > 0) + [f"{self.atol:.2g} W/sr"] * (self.atol > 0))

    def allowed(self, intensity: Float[np.ndarray, "*view band"]) -> Float[np.ndarray, "*view band"]:
        """Standard error that is good enough [W sr-1]."""
        return np.maximum(self.rtol * np.abs(intensity), self.atol)

    def excess(
        self, intensity: Float[np.ndarray, "*view band"], error: Float[np.ndarray, "*view band"]
    ) -> Float[np.ndarray, "*view"]:
        """Error over what is asked, of the worst band; 0 for what is exact, inf for what can not be met."""
        asked = self.allowed(intensity)
        beyond = np.where(error > 0, np.inf, 0.0)
        return np.asarray(np.divide(error, asked, out=beyond, where=asked > 0).max(axis=-1))

    def beyond(
        self, intensity: Float[np.ndarray, "*view band"], share: Any, of: Float[np.ndarray, "*view band"] | None = None
    ) -> Float[np.ndarray, "*view"]:
        """`excess` of an error that is a share of the intensity, or of what is given; of a dark band none counts."""
        whole = intensity if of is None else of
        share = np.asarray(share, intensity.dtype)
        error = np.multiply(share, whole, out=np.zeros_like(intensity), where=whole > 0)
        return self.excess(intensity, error)


ANY = Tolerance(0.0, math.inf)  # where nothing is asked


class Goal(NamedTuple):
    """What is asked of an image and what it may cost.

    Attributes:
        tolerance: of its radiant intensity; `ANY` where only its pixels count.
        pixel_rtol: root mean square error over the pixels that see the target, of their mean contrast to the empty
            image, of every band; None where it is not asked.
        most: rays in a pixel.
        seconds: of its rays and of those of a look at all of it, on the device in force, without compiling.
    """

    tolerance: Tolerance
    pixel_rtol: float | None
    most: int
    seconds: float

    @property
    def of_intensity(self) -> tuple[Tolerance, ...]:
        """What is asked of an intensity, and of the mean over pixels."""
        mean = () if self.pixel_rtol is None else (Tolerance(self.pixel_rtol, 0.0),)
        return self.tolerance, *mean

    @property
    def relative(self) -> float | None:
        """The least relative error that is asked; None where none is."""
        return min((rtol for rtol in (self.tolerance.rtol, self.pixel_rtol) if rtol), default=None)

    def weight(self, image: Image) -> Float[np.ndarray, "row column band"]:
        """w of each pixel: the errors asked for are met where sum_p w_p v_p <= 1 in every band, v_p the variances."""
        weight = np.zeros(image.radiance.shape[-1])
        if self.pixel_rtol is not None:
            contrast = np.abs(np.asarray(image.radiance) - np.asarray(image.empty)).astype(np.float64)
            seen = (contrast > 0).sum(axis=(0, 1))
            allowed = seen * (self.pixel_rtol * contrast.sum(axis=(0, 1)) / np.maximum(seen, 1)) ** 2
            weight = np.maximum(weight, _over(1.0, allowed))
        if self.tolerance != ANY:
            area = np.asarray(image.camera.pixel_area(), np.float64)[:, :, None]
            intensity = np.asarray(image.radiant_intensity(), np.float64)
            weight = np.maximum(weight, _over(area**2, self.tolerance.allowed(intensity) ** 2))
        return np.broadcast_to(weight, image.radiance.shape)


def shares_of(
    weight: Float[np.ndarray, "row column band"], error: Float[np.ndarray, "row column band"]
) -> Float[np.ndarray, "row column band"]:
    """w_p v_p of each pixel, see `Goal.weight`, by its standard error; `excess` tells whether the goal is met."""
    return weight * error.astype(np.float64) ** 2


def excess(shares: Float[np.ndarray, "row column band"]) -> float:
    """Error over the error asked for, of the worst band."""
    return float(np.sqrt(shares.sum(axis=(0, 1)).max()))


def _over(value: float | np.ndarray, allowed: np.ndarray) -> np.ndarray:
    """value / allowed; 0 for a dark band, of which nothing can be asked."""
    return np.where(allowed > 0, value / np.where(allowed > 0, allowed, 1), 0)


def goal_of(
    rtol: float | None, atol: float | None, pixel_rtol: float | None, max_samples: int, max_seconds: float | None
) -> Goal | None:
    """What is asked of an image; None where no error is.

    Raises:
        ValueError: as `tolerance_of`, of `pixel_rtol` too, and as `seconds_of`.
    """
    require_count("max_samples", max_samples)
    tolerance = tolerance_of(rtol, atol)
    if pixel_rtol is not None:
        require_rtol(pixel_rtol, "pixel_rtol")
    asked = tolerance is not None or pixel_rtol is not None
    seconds = seconds_of(max_seconds, "rtol, atol or pixel_rtol", asked)
    return Goal(ANY if tolerance is None else tolerance, pixel_rtol, max_samples, seconds) if asked else None


def seconds_of(max_seconds: float | None, names: str, asked: bool) -> float:
    """Seconds that are allowed, inf where None is given.

    Raises:
        ValueError: none are allowed, or none of the errors with these names is asked for.
    """
    if max_seconds is None:
        return math.inf
    _require_positive("max_seconds", max_seconds, "> 0")
    if not asked:
        raise ValueError(f"max_seconds: got {max_seconds} alone, expected {names} beside it")
    return float(max_seconds)


def require_rtol(rtol: Any, name: str = "rtol") -> None:
    """Raise `ValueError` unless the tolerance is positive and the precision in force can hold it."""
    _require_positive(name, rtol, "> 0")
    dtype = float_dtype()
    least = LEAST * float(np.finfo(dtype).eps)
    if rtol < least:
        double = LEAST * float(np.finfo(np.float64).eps)
        need = "float64: jax.config.update('jax_enable_x64', True)" if rtol >= double else "more than float64"
        raise ValueError(f"{name}: got {rtol}, expected at least {least:.2g} in {dtype}; {rtol} needs {need}")


def tolerance_of(rtol: float | None, atol: float | None) -> Tolerance | None:
    """What is asked, None where nothing is.

    Args:
        rtol: of `Tolerance`; None for 0.
        atol: of `Tolerance`; None for 0.

    Raises:
        ValueError: tolerances <= 0 or beyond the precision in force.
    """
    if rtol is not None:
        require_rtol(rtol)
    if atol is not None:
        _require_positive("atol", atol, "a finite value > 0", math.inf)
    return None if rtol is None and atol is None else Tolerance(rtol or 0.0, atol or 0.0)


def _require_positive(name: str, value: Any, expected: str, below: float = math.nan) -> None:
    """Raise `ValueError` unless a value is a number > 0, and less than `below` where that is given."""
    try:
        number = math.nan if isinstance(value, str | bool) else float(value)
    except TypeError:
        number = math.nan
    if not number > 0 or number >= below:
        got = repr(value) if isinstance(value, str) else value
        raise ValueError(f"{name}: got {got}, expected {expected}")
