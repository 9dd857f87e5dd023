"""Programs of JAX as ONNX models: a table from primitives to operators.

Loops are unrolled, and constant expressions are computed here.
"""

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import ShapeDtypeStruct as Form
from jax.extend.core import ClosedJaxpr, Literal
from jax.interpreters.partial_eval import dce_jaxpr

from carpark_formats.onnx.graph import BATCH, Graph, Named, Value

LONGEST_LOOP = 16  # iterations
_CALLS = ("jit", "pjit", "closed_call", "custom_jvp_call", "custom_vjp_call")


def make_graph(
    function: Callable[..., Mapping[str, jax.Array]], inputs: Mapping[str, Form]
) -> Any:
    """The ONNX model (`onnx.ModelProto`) of a function, which gives outputs by name.

    Of its inputs, arrays in order, the model has those that its outputs depend on, or
    all if their first axis is `BATCH`, which stands for any size. A primitive that the
    table does not have raises `NotImplementedError`.
    """
    program, outputs = jax.make_jaxpr(function, return_shape=True)(*inputs.values())
    batched = any(BATCH in x.shape[:1] for x in inputs.values())
    wanted = [True] * len(outputs)
    jaxpr, read = dce_jaxpr(program.jaxpr, wanted, instantiate=batched)
    named = [Named(name, x.shape, np.dtype(x.dtype)) for name, x in inputs.items()]
    given = [*itertools.compress(named, read)]
    graph = Graph(given[0].name if batched else "")
    found = _run(graph, ClosedJaxpr(jaxpr, program.consts), given)
    pairs = zip(sorted(outputs), found, strict=True)
    whole = {name: graph.expand(value, outputs[name].shape) for name, value in pairs}
    return graph.model(given, whole)


def _run(graph: Graph, program: ClosedJaxpr, given: Sequence[Value]) -> list[Value]:
    """Adds a program; returns its outputs."""
    jaxpr = program.jaxpr
    known: dict[Any, Value] = dict(zip(jaxpr.invars, given, strict=True))
    known |= zip(jaxpr.constvars, map(_constant, program.consts), strict=True)

    def read(variable: Any) -> Value:
        if isinstance(variable, Literal):
            kind: Any = variable.aval
            return np.asarray(variable.val, kind.dtype)
        return known[variable]

    for eqn in jaxpr.eqns:
        found = _apply(graph, eqn, [read(variable) for variable in eqn.invars])
        known |= zip(eqn.outvars, found, strict=True)
    return [read(variable) for variable in jaxpr.outvars]


def _apply(graph: Graph, eqn: Any, values: list[Value]) -> Sequence[Value]:
    """Adds an equation of a program; returns what it computes."""
    name, params = eqn.primitive.name, eqn.params
    if name in _CALLS:
        return _run(graph, params.get("jaxpr", params.get("call_jaxpr")), values)
    if name == "scan":
        return _loop(graph, params, values)
    shapes = [variable.aval for variable in eqn.outvars]
    if not any(isinstance(value, Named) for value in values):
        return _compute(eqn, values)
    if all(0 in shape.shape for shape in shapes):
        return [np.zeros(shape.shape, shape.dtype) for shape in shapes]
    if name == "optimization_barrier":
        return values
    if name in _ELEMENTWISE:
        return [_ELEMENTWISE[name](graph, shapes[0].dtype, *values, **params)]
    if name == "broadcast_in_dim":
        return [_broadcast(graph, values[0], **params)]
    if name not in _SHAPED:
        raise NotImplementedError(f"the primitive {name!r} has no operator")
    pairs = zip(values, eqn.invars, strict=True)
    whole = [graph.expand(value, variable.aval.shape) for value, variable in pairs]
    if eqn.primitive.multiple_results:
        return _SHAPED[name](graph, shapes, *whole, **params)
    return [_SHAPED[name](graph, shapes[0], *whole, **params)]


def _compute(eqn: Any, values: list[Any]) -> Sequence[Value]:
    """What an equation of constants computes."""
    pairs = zip(values, (variable.aval.shape for variable in eqn.invars), strict=True)
    # Keys, which are no NumPy arrays, have their shape.
    whole = [x if x.shape == shape else np.broadcast_to(x, shape) for x, shape in pairs]
    found = eqn.primitive.bind(*map(jnp.asarray, whole), **eqn.params)
    return list(map(_constant, found if eqn.primitive.multiple_results else [found]))


def _constant(value: Any) -> Value:
    """A constant, of size 1 along the batch, where it is the same for all of it."""
    if jnp.issubdtype(value.dtype, jax.dtypes.prng_key):
        return value
    value = np.asarray(value)
    for axis in (k for k, size in enumerate(value.shape) if size == BATCH):
        first = value.take([0], axis)
        if not np.array_equal(np.broadcast_to(first, value.shape), value):
            raise NotImplementedError("constants of a batch have no operator")
        value = first
    return value


def _loop(graph: Graph, params: Any, values: list[Value]) -> list[Value]:
    """A loop that only carries values on, written out."""
    length = params["length"]
    if "ft_in" in params:  # JAX 0.11
        consts, carried, _ = map(len, params["ft_in"].unpack())
    else:
        consts, carried = params["num_consts"], params["num_carry"]
    if length > LONGEST_LOOP or len(values) > consts + carried:
        raise NotImplementedError(f"a loop over {length} values has no operator")
    carry = values[consts:]
    for _ in range(length):
        carry = _run(graph, params["jaxpr"], [*values[:consts], *carry])
    return carry


def _broadcast(graph: Graph, value: Value, **params: Any) -> Value:
    """Axes where operators look for them; none is repeated yet."""
    rank, shape = len(value.shape), params["shape"]
    axes = params["broadcast_dimensions"]
    axes = axes[len(axes) - rank :]  # those in front are of size 1
    if axes == tuple(range(len(shape) - rank, len(shape))):
        return value
    sizes = dict(zip(axes, value.shape, strict=True))
    return graph.reshape(value, [sizes.get(axis, 1) for axis in range(len(shape))])


def _operator(kind: str, **attributes: Any) -> Callable[..., Value]:
    """Adds one operator, whatever the primitive's parameters."""

    def add(graph: Graph, dtype: Any, *values: Value, **params: Any) -> Value:
        del params
        return graph.elementwise(kind, dtype, *values, **attributes)

    return add


def _not_equal(graph: Graph, dtype: Any, *values: Value) -> Value:
    return graph.elementwise("Not", dtype, graph.elementwise("Equal", dtype, *values))


def _is_finite(graph: Graph, dtype: Any, value: Value) -> Value:
    # inf - inf is NaN, and no NaN equals itself
    rest = graph.elementwise("Sub", value.dtype, value, value)
    return graph.elementwise("Equal", dtype, rest, rest)


def _select(graph: Graph, dtype: Any, which: Value, no: Value, yes: Value) -> Value:
    if np.dtype(dtype).kind != "b":
        return graph.elementwise("Where", dtype, which, yes, no)
    otherwise = graph.elementwise("Not", bool, which)
    first = graph.elementwise("And", bool, which, yes)
    second = graph.elementwise("And", bool, otherwise, no)
    return graph.elementwise("Or", bool, first, second)


def _power(graph: Graph, dtype: Any, value: Value, y: int = 2) -> Value:
    if y == 2:
        return graph.elementwise("Mul", dtype, value, value)
    return graph.elementwise("Pow", dtype, value, np.asarray(y, dtype))


def _inverse_root(graph: Graph, dtype: Any, value: Value, **params: Any) -> Value:
    root = graph.elementwise("Sqrt", dtype, value)
    return graph.elementwise("Reciprocal", dtype, root)


def _arctan2(graph: Graph, dtype: Any, y: Value, x: Value) -> Value:
    zero, one, half_turn = (np.asarray(value, dtype) for value in (0.0, 1.0, np.pi))
    add = graph.elementwise
    still = [add("Equal", bool, value, zero) for value in (x, y)]
    divisor = add("Where", dtype, add("And", bool, *still), one, x)
    side = add("Where", dtype, add("Less", bool, y, zero), -half_turn, half_turn)
    turn = add("Where", dtype, add("Less", bool, x, zero), side, zero)
    return add("Add", dtype, add("Atan", dtype, add("Div", dtype, y, divisor)), turn)


def _clamp(graph: Graph, dtype: Any, low: Value, value: Value, high: Value) -> Value:
    least = graph.elementwise("Max", dtype, value, low)
    return graph.elementwise("Min", dtype, least, high)


# Primitives whose operators have their names.
_SAME = (
    *("abs", "add", "and", "atan", "ceil", "cos", "div", "exp", "floor", "log", "max"),
    *("min", "mul", "neg", "not", "or", "sign", "sin", "sqrt", "sub", "tan", "tanh"),
    "xor",
)
# By primitive: of values that broadcast.
_ELEMENTWISE: dict[str, Callable[..., Value]] = {
    **{name: _operator(name.capitalize()) for name in _SAME},
    "atan2": _arctan2,
    "clamp": _clamp,
    "convert_element_type": lambda graph, dtype, value, **_: graph.cast(value, dtype),
    "eq": _operator("Equal"),
    "ge": _operator("GreaterOrEqual"),
    "gt": _operator("Greater"),
    "integer_pow": _power,
    "is_finite": _is_finite,
    "le": _operator("LessOrEqual"),
    "logistic": _operator("Sigmoid"),
    "lt": _operator("Less"),
    "ne": _not_equal,
    "rem": _operator("Mod", fmod=1),  # of the dividend's sign
    "rsqrt": _inverse_root,
    "select_n": _select,
    "square": _power,
    "stop_gradient": lambda graph, dtype, value: value,
}


def _stack(graph: Graph, like: Any, *values: Value, axis: int) -> Value:
    shape = [1 if k == axis else size for k, size in enumerate(like.shape)]
    return graph.join([graph.reshape(value, shape) for value in values], axis, like)


def _split(graph: Graph, likes: Any, value: Value, sizes: Any, axis: int) -> Any:
    del likes
    edges = np.cumsum([0, *sizes]).tolist()
    return [graph.part(value, axis, *two) for two in itertools.pairwise(edges)]


def _unstack(graph: Graph, likes: Any, value: Value, axis: int) -> Any:
    return [
        graph.reshape(graph.part(value, axis, k, k + 1), like.shape)
        for k, like in enumerate(likes)
    ]


def _slice(graph: Graph, like: Any, value: Value, **params: Any) -> Value:
    del like
    starts, ends = params["start_indices"], params["limit_indices"]
    return graph.slice(value, starts, ends, params["strides"])


def _concatenate(graph: Graph, like: Any, *values: Value, dimension: int) -> Value:
    return graph.join([x for x in values if 0 not in x.shape], dimension, like)


def _reshape(graph: Graph, like: Any, value: Value, **params: Any) -> Value:
    return graph.reshape(value, like.shape)


def _pad(graph: Graph, like: Any, value: Value, fill: Value, **params: Any) -> Value:
    low, high, inside = zip(*params["padding_config"], strict=True)
    if any(inside):
        raise NotImplementedError("padding between values has no operator")
    return graph.add("Pad", value, np.array([*low, *high], np.int64), fill, like=like)


def _reduce(kind: str) -> Callable[..., Value]:
    def add(graph: Graph, like: Any, value: Value, **params: Any) -> Value:
        axes = np.array(params["axes"], np.int64)
        pair = [value.shape[axis] for axis in axes] == [2] and value.dtype.kind == "f"
        if pair and kind != "ReduceSum":
            # onnxruntime's extremes of two keep NaN, those along an axis drop it.
            two = (graph.part(value, int(axes[0]), k, k + 1) for k in (0, 1))
            found = graph.elementwise(kind[-3:], like.dtype, *two)
            return graph.reshape(found, like.shape)
        if value.dtype != bool:
            return graph.add(kind, value, axes, like=like, keepdims=0)
        number, whole = graph.cast(value, np.int32), Form(like.shape, np.int32)
        found = graph.add(kind, number, axes, like=whole, keepdims=0)
        return graph.cast(found, bool)

    return add


def _arg_reduce(kind: str) -> Callable[..., Value]:
    def add(graph: Graph, like: Any, value: Value, **params: Any) -> Value:
        [axis] = params["axes"]
        whole = Form(like.shape, np.int64)
        if value.dtype == bool:
            value = graph.cast(value, np.int32)
        found = graph.add(kind, value, like=whole, axis=axis, keepdims=0)
        return graph.cast(found, like.dtype)

    return add


def _dot_general(graph: Graph, like: Any, a: Value, b: Value, **params: Any) -> Value:
    """As a product of matrices: batches, what is free, what is summed over."""
    (sum_a, sum_b), (batch_a, batch_b) = params["dimension_numbers"]

    def matrices(value: Value, batch: Any, summed: Any, last: bool) -> Value:
        rest = [k for k in range(len(value.shape)) if k not in (*batch, *summed)]
        parts = [batch, rest, summed] if last else [batch, summed, rest]
        sizes = [math.prod(value.shape[k] for k in part) for part in parts]
        order = [axis for part in parts for axis in part]
        return graph.reshape(graph.transpose(value, order), sizes)

    left = matrices(a, batch_a, sum_a, last=True)
    right = matrices(b, batch_b, sum_b, last=False)
    shape = (left.shape[0], left.shape[1], right.shape[2])
    if shape[0] == 1:
        left, right = (graph.reshape(x, x.shape[1:]) for x in (left, right))
    like_matrix = Form(shape[shape[0] == 1 :], like.dtype)
    found = graph.add("MatMul", left, right, like=like_matrix)
    return graph.reshape(found, like.shape)


def _gather(graph: Graph, like: Any, value: Value, at: Value, **params: Any) -> Value:
    """Rows of a table: axes that are indexed come in front and are joined into one."""
    numbers, sizes = params["dimension_numbers"], params["slice_sizes"]
    lead, batch = at.shape[:-1], numbers.operand_batching_dims
    starts, moving = [0] * len(value.shape), {}
    for k, axis in enumerate(numbers.start_index_map):
        index = graph.reshape(graph.part(at, len(lead), k, k + 1), lead)
        if isinstance(index, Named) or np.ptp(index):
            moving[axis] = index
        else:
            most = value.shape[axis] - sizes[axis]
            starts[axis] = min(max(int(index.flat[0]), 0), most)
    front = [*batch, *moving]
    if any(sizes[axis] != 1 for axis in front):
        raise NotImplementedError("windows that move have no operator")
    rest = [axis for axis in range(len(value.shape)) if axis not in front]
    ends = list(value.shape)
    for axis in rest:
        ends[axis] = starts[axis] + sizes[axis]
    value = graph.transpose(graph.slice(value, starts, ends), [*front, *rest])
    counts, whole = value.shape[: len(front)], value.shape[len(front) :]
    table = graph.reshape(value, [math.prod(counts), *whole])
    row: Value = np.zeros([1] * len(lead), np.int32)
    for axis in numbers.start_indices_batching_dims:
        row = row * lead[axis] + np.indices(lead, np.int32)[axis]
    inside: Value = np.asarray(True)
    for count, index in zip(counts[len(batch) :], moving.values(), strict=True):
        least, most = np.asarray(0, np.int32), np.asarray(count - 1, np.int32)
        index = graph.cast(index, np.int32)
        clipped = _clamp(graph, np.int32, least, index, most)
        same = graph.elementwise("Equal", bool, clipped, index)
        inside = graph.elementwise("And", bool, inside, same)
        row = graph.elementwise("Mul", np.int32, row, np.asarray(count, np.int32))
        row = graph.elementwise("Add", np.int32, row, clipped)
    shape = Form((*lead, *whole), value.dtype)
    row = graph.expand(row, lead)
    found: Value = graph.add("Gather", table, row, like=shape, axis=0)
    if params["mode"] == jax.lax.GatherScatterMode.FILL_OR_DROP and moving:
        inside = graph.reshape(graph.expand(inside, lead), [*lead, *[1] * len(whole)])
        fill = np.asarray(params["fill_value"], value.dtype)
        found = _select(graph, value.dtype, inside, fill, found)
    # The rows' axes come where the result has them, those of the index in order.
    offset = numbers.offset_dims
    dropped = (*numbers.collapsed_slice_dims, *batch)
    kept = [size for k, size in enumerate(sizes) if k not in dropped]
    ahead = [k for k in range(len(like.shape)) if k not in offset]
    order = np.argsort([*ahead, *offset]).tolist()
    return graph.transpose(graph.reshape(found, [*lead, *kept]), order)


# By primitive: of values in their whole shapes.
_SHAPED: dict[str, Callable[..., Any]] = {
    "argmax": _arg_reduce("ArgMax"),
    "argmin": _arg_reduce("ArgMin"),
    "concatenate": _concatenate,
    "dot_general": _dot_general,
    "gather": _gather,
    "pad": _pad,
    "reduce_and": _reduce("ReduceMin"),
    "reduce_max": _reduce("ReduceMax"),
    "reduce_min": _reduce("ReduceMin"),
    "reduce_or": _reduce("ReduceMax"),
    "reduce_sum": _reduce("ReduceSum"),
    "reshape": _reshape,
    "slice": _slice,
    "split": _split,
    "squeeze": _reshape,
    "unstack": _unstack,
    "stack": _stack,
    "transpose": lambda graph, like, x, permutation: graph.transpose(x, permutation),
}
