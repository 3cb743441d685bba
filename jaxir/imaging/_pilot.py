"""A few chunks of an image, to foretell the error and the time of the whole."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import NamedTuple

import jax
import numpy as np

from jaxir._arrays import as_float
from jaxir._concurrent import cores, each_of
from jaxir._programs import of_items
from jaxir.imaging._chunks import Chunk, Pass, as_number, estimate_chunk
from jaxir.imaging._estimate import Estimate, by_strata
from jaxir.imaging._image import share_left_out

CHUNKS = 8  # of a pilot; all of a small image
SECONDS = 2.0  # after which a pilot takes no more chunks
OF_PILOTS = 2**32 - 1  # the number of the pass that pilots take part of
QUICK = 0.01  # seconds up to which chunks are timed twice: other work may disturb it


class Pilot(NamedTuple):
    """What is foretold of one pass over the whole image.

    Attributes:
        intensity: contrast intensity [band] [W sr-1].
        variance: of it [band].
        seconds: without compiling.
        compile_seconds: until the first chunk was there.
        truncation: share of the intensity that is left out of what particles scatter [band], see `Image.truncation`.
    """

    intensity: np.ndarray
    variance: np.ndarray
    seconds: float
    compile_seconds: float
    truncation: np.ndarray


def pilot(taken: Pass) -> Pilot:
    """Compute some chunks of a pass; each is a systematic sample of the image's tiles, so few stand for all."""
    chunks, taken = taken.chunks().each(), taken._replace(number=as_number(OF_PILOTS))
    of, together, count = of_items(estimate_chunk, taken.of_chunks()), cores(), len(chunks)
    compiled = _timed(of, chunks[:1])[1]
    chosen = np.unique(np.linspace(0, count - 1, CHUNKS).astype(np.int32))
    sums, times = [], []
    for begin in range(0, len(chosen), together):
        some = chosen[begin : begin + together]
        own = [chunks[number] for number in some]
        estimates, spent = _timed(of, own)
        spent = spent if spent > QUICK else min(spent, _timed(of, own)[1])
        times += [spent / len(some)] * len(some)
        sums += [_contribution(taken, int(index), one) for index, one in zip(some, estimates, strict=True)]
        if sum(times) > SECONDS:
            break
    every = (np.mean(part, axis=0) * count for part in zip(*sums, strict=True))
    intensity, variance, within, alike, among, orders = every
    share = by_strata(alike, among)
    variance = (1 - share) * variance + share * within
    sampled = taken.method.samples_particles(taken.lit.scene)
    left = np.asarray(share_left_out(as_float(orders) if sampled else None, taken.lacking, as_float(intensity)))
    return Pilot(intensity, variance, float(np.mean(times)) * count, compiled, left)


def _timed(of: Callable[[Chunk], Estimate], chunks: list[Chunk]) -> tuple[list[Estimate], float]:
    """Chunks, and the seconds that they took together."""
    began = time.perf_counter()
    every = each_of(lambda chunk: jax.block_until_ready(of(chunk)), chunks, ready=len(chunks) > 1)
    estimates = list(every)
    return estimates, time.perf_counter() - began


def _contribution(taken: Pass, chunk: int, estimate: Estimate) -> tuple[np.ndarray, ...]:
    """Sums over the pixels of one chunk.

    Intensity, its variance, that within strata, what tells of their share, see `by_strata`, [band] each; and the last
    two orders of scattering [2, band].
    """
    index = taken.camera.pixel_index(taken.numbers[chunk])
    area = np.append(np.asarray(taken.camera.pixel_area(), np.float64).ravel(), 0.0)[index][:, :, None]
    found = estimate.mean, estimate.variance, estimate.within, estimate.empty
    mean, variance, within, empty = (np.asarray(leaf, np.float64) for leaf in found)
    there = np.where(area > 0, within, 0)
    orders = np.zeros((1, 1, 2, mean.shape[-1])) if estimate.orders is None else np.asarray(estimate.orders, np.float64)
    own = (mean - empty) * area, variance * area**2, within * area**2, there, there**2, orders * area[..., None]
    return tuple(part.sum((0, 1)) for part in own)


class ErrorLaw(NamedTuple):
    """Variance of an intensity over rays per pixel N, [band]: noise / N + edge / N^1.5 + smooth / N^3.

    Lights sampled at every point are independent: variance as 1 / N. A silhouette crosses sqrt(N) of the N strata of a
    pixel, each with an error of the order of its size 1 / N: variance as N^-1.5. That of a smooth field falls as N^-2
    or, from few points to more, as N^-3.
    """

    noise: np.ndarray
    edge: np.ndarray
    smooth: np.ndarray

    def variance(self, samples: int) -> np.ndarray:
        """[band]."""
        return self.noise / samples + self.edge / samples**1.5 + self.smooth / samples**3

    def samples(self, allowed: np.ndarray, most: int) -> int:
        """The fewest rays per pixel, of well-shaped strata, with a variance of at most `allowed` [band]."""
        for samples in well_shaped(most):
            if (self.variance(samples) <= allowed).all():
                break
        return samples


def error_law(few: tuple[int, Pilot], more: tuple[int, Pilot]) -> ErrorLaw:
    """The law through two pilots, (rays per pixel, pilot) each, by the two neighbouring powers that bracket both."""
    (n, first), (m, second) = few, more

    def steeper(low: float, high: float) -> np.ndarray:
        """b of a / N^low + b / N^high through both pilots, a and b at least 0."""
        slow, fast = first.variance * n**low - second.variance * m**low, n ** (low - high) - m ** (low - high)
        return np.clip(slow / fast, 0, second.variance * m**high)

    smooth = steeper(1.5, 3.0)
    edge = np.minimum(steeper(1.0, 1.5), np.maximum(second.variance - smooth / m**3, 0) * m**1.5)
    return ErrorLaw(np.maximum(second.variance - edge / m**1.5 - smooth / m**3, 0) * m, edge, smooth)


def well_shaped(most: int) -> list[int]:
    """Even rays per pixel up to `most` whose strata, two rays in each, are squares or nearly so."""
    halves = [k * (k + more) for k in range(1, math.isqrt(most) + 1) for more in (0, 1)]
    return [2 * half for half in halves if 2 * half <= most] or [2]
