"""Planck's law: spectral and bin-integrated blackbody radiance, right in float32 from 3 K to 6000 K.

With x = c2 nu / T the radiance of a bin is

    B = K T^4 int_{x1}^{x2} x^3 e^{-x} / (1 - e^{-x}) dx,      K = 2 h c^2 / c2^4.

Written with v = e^{-(x - x1)/6} the exponential leaves the integrand,

    B = 6 K T^4 e^{-x1} int_{v2}^1 v^5 x^3 / (1 - e^{-x}) dv,   x = x1 - 6 ln v,

and Gauss-Legendre in v converges for wide bins and narrow ones, hot and cold, without a branch: 10 points err by
2e-8 relative, 40 points by 2e-14 (over 1e-2 < x1 < 2e3, 0.05 < x2 - x1 < 3e3, against 30-digit quadrature).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial, reduce
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Array, ArrayLike, Float

from jaxir._arrays import Check, as_float, as_one_program, known, non_negative, require, thermal
from jaxir._math import gauss_legendre, on_platform
from jaxir.optics.spectrum._band import (
    SECOND_RADIATION,
    Band,
    Nodes,
    as_bands,
    as_nodes,
    wavelength_to_wavenumber,
)
from jaxir.optics.spectrum._resolve import resolved_nodes

FIRST_RADIATION = 1.1910429723971884e-8  # 2 h c^2 [W m-2 sr-1 / (cm-1)^4], exact since 2019 (CODATA 2018)
STEFAN = FIRST_RADIATION / SECOND_RADIATION**4  # K [W m-2 sr-1 K-4]; sigma = pi^5 K / 15
_STRETCH = 6.0
_POINTS = {4: 10, 8: 40}  # Gauss-Legendre points by dtype size
_BLOCK = 512  # temperatures
_NARROW = 25.0  # bins in which the response of a band is taken as its mean [cm-1], and narrower ones where it varies
_HOTTER = 4.0  # times by which a step of Newton's method raises a temperature at most, which would pass infinity
_WRITTEN_OUT = 10  # points that are terms of one expression at most


def spectral_radiance(
    wavenumber: Float[Array, "*batch"], temperature: Float[Array, "*batch"]
) -> Float[Array, "*batch"]:
    """Blackbody radiance per wavenumber, 2 h c^2 nu^3 e^{-x} / (1 - e^{-x}).

    The form e^{-x} / (1 - e^{-x}) keeps a derivative where 1 / (e^x - 1) in float32 has none (x > 44).

    Args:
        wavenumber: nu > 0 [cm-1].
        temperature: T > 0 [K].

    Returns:
        Radiance [W m-2 sr-1 / cm-1].

    Differentiable in both.
    """
    x = SECOND_RADIATION * wavenumber / temperature
    return FIRST_RADIATION * wavenumber**3 * jnp.exp(-x) / -jnp.expm1(-x)


def spectral_radiance_on_host(wavenumber: np.ndarray, temperature: float) -> np.ndarray:
    """The same in double precision by numpy; beyond x of 700 what it is there."""
    x = SECOND_RADIATION * np.float64(wavenumber) / temperature
    return FIRST_RADIATION * np.float64(wavenumber) ** 3 / np.expm1(np.minimum(x, 700))


def spectral_radiance_wavelength(
    wavelength: Float[Array, "*batch"], temperature: Float[Array, "*batch"]
) -> Float[Array, "*batch"]:
    """Blackbody radiance per wavelength [W m-2 sr-1 / um] at `wavelength` [um]; see `spectral_radiance`."""
    wavenumber = wavelength_to_wavenumber(wavelength)
    return spectral_radiance(wavenumber, temperature) * wavenumber / wavelength


def band_radiance(
    temperature: Float[ArrayLike, "*batch"], nodes: Nodes | Band | Sequence[Band]
) -> Float[Array, "*batch node"]:
    """Blackbody radiance integrated over each node's bin; the equation is at the head of this file.

    In float32 the quotient c2 nu / T is carried with its remainder, because an error in x1 is a relative error of
    the same size in e^{-x1} and x1 reaches 19 in the paper's bands; the result errs by less than 1e-6.

    Args:
        temperature: T > 0 [*batch] [K].
        nodes: the bins, or bands, each of which is one, whatever its response.

    Returns:
        Radiance [*batch, node] [W m-2 sr-1]; underflows to exactly 0 for x1 beyond 87 in float32.

    Raises:
        ValueError: a known temperature that is not > 0.

    Differentiable in temperature.
    """
    return _band_radiance(_checked(thermal, "band_radiance: temperature", temperature), nodes)


def _checked(within: Callable[[str, Array], Check], field: str, value: Any) -> Array:
    """As an array, in range where it is known; elsewhere nothing is traced for it."""
    array = value if isinstance(value, Array) else as_float(value)
    if known(array) is not None:
        require([within(field, array)])
    return array


@as_one_program
def _band_radiance(temperature: Array, nodes: Nodes | Band | Sequence[Band]) -> Array:
    nodes, hot = as_nodes(nodes), temperature.reshape(-1)
    radiance = on_platform(nodes, hot, cpu=_in_blocks, default=_at_once)
    return radiance.reshape(*temperature.shape, nodes.count)


def _at_once(nodes: Nodes, temperature: Float[Array, " batch"]) -> Float[Array, "batch node"]:
    """`band_radiance` of one axis."""
    width = (nodes.edge[:, 1, 0] - nodes.edge[:, 0, 0]) + (nodes.edge[:, 1, 1] - nodes.edge[:, 0, 1])

    shape = (nodes.count, temperature.shape[0])
    of_node = (jnp.broadcast_to(x[:, None], shape) for x in (nodes.edge[:, 0, 0], nodes.edge[:, 0, 1], width))
    return _bin_radiance(jnp.broadcast_to(temperature[None], shape), *of_node).T


def _in_blocks(nodes: Nodes, temperature: Float[Array, " batch"]) -> Float[Array, "batch node"]:
    """`_at_once`, a block of temperatures after another, within which XLA's innermost loop is long enough for SIMD.

    Left to itself it runs over nodes: the values of two or three bands take 8 times as long, gradients of any 5 times.
    """
    count = temperature.shape[0]
    if count <= _BLOCK:
        return _at_once(nodes, temperature)
    blocks = jnp.pad(temperature, (0, -count % _BLOCK), constant_values=300.0).reshape(-1, _BLOCK)
    found = lax.map(lambda block: _at_once(nodes, block).T, blocks)
    return jnp.moveaxis(found, 1, 2).reshape(-1, nodes.count)[:count]


@as_one_program
def blackbody_fraction(wavelength_temperature: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
    """Fraction F(0 -> lambda T) of the blackbody exitance below a wavelength.

    Args:
        wavelength_temperature: lambda T > 0 [um K].

    Returns:
        F in [0, 1].

    Differentiable in its argument.
    """
    x = 1e4 * SECOND_RADIATION / wavelength_temperature
    one = jnp.ones_like(x)
    beyond = jnp.full_like(x, 200.0)  # e^-200: the rest of the spectrum
    return _bin_radiance(one, x, jnp.zeros_like(x), beyond) * (15 / np.pi**4 / STEFAN)


@jax.custom_jvp
def _bin_radiance(
    temperature: Float[Array, "*batch"],
    lead: Float[Array, "*batch"],
    rest: Float[Array, "*batch"],
    width: Float[Array, "*batch"],
) -> Float[Array, "*batch"]:
    """K T^4 times the integral of x^3/(e^x - 1) from (lead + rest)/T over width/T."""
    return _with_slope(temperature, lead, rest, width)[0]


@partial(_bin_radiance.defjvp, symbolic_zeros=True)
def _bin_radiance_jvp(primals: tuple[Array, ...], tangents: tuple[Any, ...]) -> tuple[Array, Array]:
    # a rule of its own, because transposed terms would each be stored: a gradient then costs ten times as much
    temperature, lead, rest, width = primals
    value, slope = _with_slope(*primals)
    moved = [None if type(tangent) is SymbolicZero else tangent for tangent in tangents]
    change = jnp.zeros_like(value) if moved[0] is None else slope * moved[0]
    if any(tangent is not None for tangent in moved[1:]):
        low, high = (STEFAN * temperature**3 * _wien_to_jeans(x / temperature) for x in (lead, lead + rest + width))
        for tangent in moved[1:3]:
            change = change if tangent is None else change + (high - low) * tangent
        change = change if moved[3] is None else change + high * moved[3]
    return value, change


def _wien_to_jeans(x: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
    """x^3/(e^x - 1)."""
    return x**3 * jnp.exp(-x) / -jnp.expm1(-x)


def _with_slope(temperature: Array, lead: Array, rest: Array, width: Array) -> tuple[Array, Array]:
    """`_bin_radiance`, and its derivative with T, K T^3 times the integral of x^4 e^x/(e^x - 1)^2: the same points."""
    point, weight = gauss_legendre(_POINTS[temperature.dtype.itemsize])
    first = lead / temperature
    error = (lax.stop_gradient(_remainder(lead, temperature)) + rest) / temperature
    reach = -jnp.expm1(-width / (temperature * _STRETCH))
    held = reach, first, jnp.exp(-first), -jnp.expm1(-first)  # the last are e^{-x1}, 1 - e^{-x1}

    def term(point: Any, weight: Any, held: tuple[Array, ...] = held) -> tuple[Array, Array]:
        reach, first, passed, stopped = held
        inside = reach * point
        v = 1 - inside
        x = first - _STRETCH * jnp.log1p(-inside)
        powers = 1 + v * (1 + v * (1 + v * (1 + v * (1 + v))))
        # 1 - e^{-x} = (1 - e^{-x1}) + e^{-x1} (1 - v^6): sums of what is positive, and no exponential of each point
        scale = 1 / (stopped + passed * (inside * powers))
        brought = weight * v**5 * x**3 * scale
        return brought, brought * x * scale

    pairs, dark = (point.tolist(), weight.tolist()), (jnp.zeros_like(first), jnp.zeros_like(first))

    def added(sums: tuple[Array, Array], pair: tuple[Any, ...]) -> tuple[tuple[Array, Array], None]:
        brought = term(*pair)
        return (sums[0] + brought[0], sums[1] + brought[1]), None

    # In a long batch an axis of points would become short sums, slow ones, and a loop over points takes a fifth longer
    # than terms that are written out. In a short one each such term may be compiled by itself.
    if temperature.ndim == 0 or temperature.shape[-1] < _BLOCK:
        axis = (-1,) + (1,) * temperature.ndim
        points, weights = (as_float(values).reshape(axis) for values in pairs)
        integral, rising = (x.sum(axis=0) for x in term(points, weights, tuple(x[None] for x in held)))
    elif point.size <= _WRITTEN_OUT:
        integral, rising = reduce(lambda sums, pair: added(sums, pair)[0], zip(*pairs, strict=True), dark)
    else:
        integral, rising = lax.scan(added, dark, tuple(as_float(values) for values in pairs))[0]
    half = jnp.exp(-first / 2)  # squared last: e^{-x1} alone would underflow before the radiance does

    def scaled(power: Array, integral: Array) -> Array:
        return (_STRETCH * STEFAN) * power * (temperature**3 * (reach * integral)) * (1 - error) * half * half

    return scaled(temperature, integral), scaled(jnp.ones_like(temperature), rising)


def _remainder(dividend: Array, divisor: Array) -> Array:
    """dividend - fl(dividend / divisor) * divisor, free of rounding in float32 (Dekker's product on split factors)."""
    quotient = dividend / divisor
    if dividend.dtype != jnp.float32:
        return jnp.zeros_like(dividend)
    a, b = _split(quotient), _split(divisor)
    return (((dividend - a[0] * b[0]) - a[0] * b[1]) - a[1] * b[0]) - a[1] * b[1]


def _split(value: Array) -> tuple[Array, Array]:
    """A float32 as the sum of two halves of 12 bits, whose products are exact."""
    bits = lax.bitcast_convert_type(value, jnp.uint32) & jnp.uint32(0xFFFFF000)
    high = lax.bitcast_convert_type(bits, jnp.float32)
    return high, value - high


def brightness_temperature(
    radiance: Float[ArrayLike, "*batch band"], nodes: Nodes | Band | Sequence[Band]
) -> Float[Array, "*batch band"]:
    """Temperature of the blackbody with the same in-band radiance, by Newton's method in ln B(1/T).

    Args:
        radiance: in-band radiance >= 0 [*batch, band] [W m-2 sr-1].
        nodes: the bins of the bands, or bands; of one with a response the radiance is that which passes it.

    Returns:
        Temperature [*batch, band] [K]; 0 where nothing arrives.

    Raises:
        ValueError: a known radiance that is not >= 0.

    Differentiable in radiance, but where nothing arrives: there the slope, which has no limit, is given as 0.
    """
    seen = _checked(non_negative, "brightness_temperature: radiance", radiance)
    return _brightness_temperature(seen, nodes)


@as_one_program
def _brightness_temperature(radiance: Array, nodes: Nodes | Band | Sequence[Band]) -> Array:
    some = radiance > 0
    if not isinstance(nodes, Nodes) and any(band.response is not None for band in as_bands(nodes)):
        nodes = resolved_nodes(nodes, _NARROW, 1, 0)
    inverse = _inverse_temperature(jnp.log(jnp.where(some, radiance, 1)), as_nodes(nodes))
    return jnp.where(some, 1 / inverse, 0)


@jax.custom_jvp
def _inverse_temperature(wanted: Array, nodes: Nodes) -> Array:
    """1 / T of each band at which ln B is `wanted`; d(1 / T) = d ln B / (d ln B / d(1 / T)), the nodes held."""

    def newton(inverse: Array, _: None) -> tuple[Array, None]:
        value, slope = _log_bands(inverse, nodes)
        return jnp.maximum(inverse + (wanted - value) / slope, inverse / _HOTTER), None

    return lax.scan(newton, jnp.full_like(wanted, 1 / 600.0), length=12)[0]


@_inverse_temperature.defjvp
def _(at: tuple[Array, Nodes], along: tuple[Array, Any]) -> tuple[Array, Array]:
    inverse = _inverse_temperature(*at)
    return inverse, along[0] / _log_bands(inverse, at[1])[1]


def _log_bands(inverse: Array, nodes: Nodes) -> tuple[Array, Array]:
    """ln B of each band at its own 1 / T, and its slope."""

    def value(inverse: Array) -> Array:
        return jnp.log(jnp.diagonal(nodes.in_band(band_radiance(1 / inverse, nodes)), axis1=-2, axis2=-1))

    return jax.jvp(value, (inverse,), (jnp.ones_like(inverse),))
