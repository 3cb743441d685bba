"""Loops of unknown length as JAX primitives with hand-written derivatives in both modes.

Reverse mode of a `lax.fori_loop` whose length depends on the data does not exist, and that of a scan stores every
step. A `custom_vjp` repairs reverse mode and forbids forward mode. A pair of primitives that are linear in the
tangents, each other's transpose, gives both: the derivative of a primitive is a linear primitive, JAX transposes that
one by rule, and no step is stored in either direction.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import jax
from jax import lax
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir


def streaming_primitive(name: str, function: Callable[..., list], shapes: Callable[..., list]) -> Primitive:
    """A primitive that runs `function` as it stands.

    Under `vmap` it is called once per element, in order: widening a loop of unknown length would run every element
    for as long as the longest.

    Args:
        name: shown in jaxprs.
        function: from arrays, and static parameters by keyword, to a list of arrays; holds plain JAX operations.
        shapes: from the arguments' abstract values, and the same parameters, to those of the results.

    Returns:
        The primitive; derivatives are registered by the caller.
    """
    primitive = Primitive(name)
    primitive.multiple_results = True
    compiled: dict[tuple, Callable[..., list]] = {}

    def run(*operands: Any, **params: Any) -> list:
        key = tuple(sorted(params.items()))
        if key not in compiled:
            compiled[key] = jax.jit(lambda *arrays: function(*arrays, **params))
        return compiled[key](*operands)

    def one_by_one(operands: Sequence[Any], axes: Sequence[Any], **params: Any) -> tuple[list, list[int]]:
        mapped = [i for i, axis in enumerate(axes) if axis is not None]
        moved = [jax.numpy.moveaxis(operands[i], axes[i], 0) for i in mapped]

        def call(elements: list) -> list:
            arguments = list(operands)
            for i, element in zip(mapped, elements, strict=True):
                arguments[i] = element
            return primitive.bind(*arguments, **params)

        results = lax.map(call, moved)
        return results, [0] * len(results)

    primitive.def_impl(run)
    primitive.def_abstract_eval(shapes)
    batching.primitive_batchers[primitive] = one_by_one
    mlir.register_lowering(primitive, mlir.lower_fun(function, multiple_results=True))
    return primitive


def is_active(tangent: Any) -> bool:
    """Whether `tangent` is anything but a symbolic zero."""
    return not isinstance(tangent, ad.Zero)


def zero_like(abstract: Any) -> Any:
    """A symbolic zero tangent of the results with abstract value `abstract`."""
    return ad.Zero(abstract.to_tangent_aval())


def register_jvp(primitive: Primitive, rule: Callable[..., tuple[list, list]]) -> None:
    """`rule(primals, tangents, **params) -> (results, tangents)`; tangents may be symbolic zeros."""
    ad.primitive_jvps[primitive] = rule


def partly(function: Callable, operands: Sequence[Any], places: Sequence[int]) -> Callable:
    """`function` of its operands at `places` alone, the others held."""

    def of_these(*values: Any) -> Any:
        arguments = list(operands)
        for place, value in zip(places, values, strict=True):
            arguments[place] = value
        return function(*arguments)

    return of_these


def along_active(function: Callable[..., list], primals: Sequence[Any], tangents: Sequence[Any]) -> tuple[list, list]:
    """`jax.jvp` of ordinary operations along those tangents that are not symbolic zeros."""
    places = [place for place, tangent in enumerate(tangents) if is_active(tangent)]
    of_active = partly(function, primals, places)
    return jax.jvp(of_active, [primals[place] for place in places], [tangents[place] for place in places])


def register_linear(
    primitive: Primitive, transposed: Primitive, constants: int, plain: Callable[..., list] | None = None
) -> None:
    """Declare that `primitive` is linear in all operands after the first `constants`, with `transposed` as transpose.

    Both take the same constants; `transposed` maps cotangents of the results to cotangents of the linear operands.
    `plain`, the same in ordinary operations, is differentiated along constants, where these are not the geometry that
    nobody differentiates.
    """

    def jvp(primals: Sequence[Any], tangents: Sequence[Any], **params: Any) -> tuple[list, list]:
        if any(is_active(tangent) for tangent in tangents[:constants]):
            assert plain is not None
            return along_active(partial(plain, **params), primals, tangents)
        results = primitive.bind(*primals, **params)
        if not any(is_active(tangent) for tangent in tangents[constants:]):
            return results, [zero_like(jax.typeof(result)) for result in results]
        linear = [ad.instantiate_zeros(tangent) for tangent in tangents[constants:]]
        return results, primitive.bind(*primals[:constants], *linear, **params)

    def transpose(cotangents: Sequence[Any], *operands: Any, **params: Any) -> list:
        fixed, linear = operands[:constants], operands[constants:]
        if not all(ad.is_undefined_primal(operand) for operand in linear):
            raise NotImplementedError(f"{primitive.name}: transposition with respect to only some linear operands")
        found = transposed.bind(*fixed, *[ad.instantiate_zeros(ct) for ct in cotangents], **params)
        return [None] * constants + list(found)

    ad.primitive_jvps[primitive] = jvp
    ad.primitive_transposes[primitive] = transpose
