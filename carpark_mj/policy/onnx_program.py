"""Programs of JAX as ONNX models: a table from primitives to operators.

Shapes are static but for a batch, loops are unrolled, and constant expressions are
computed here. A value may have a smaller shape than it stands for if it broadcasts to
that shape, because operators broadcast.
"""

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr, Literal
from jax.interpreters.partial_eval import dce_jaxpr

OPSET, IR_VERSION = 18, 8  # onnxruntime takes them from 1.14 on
# The batch's size while a program is translated; no other size is a multiple of it.
BATCH = 7919
LONGEST_LOOP = 16  # iterations
_CALLS = ("jit", "pjit", "closed_call", "custom_jvp_call", "custom_vjp_call")


class Named(NamedTuple):
    """A value that depends on inputs."""

    name: str
    shape: tuple[int, ...]
    dtype: Any


Value = Named | np.ndarray  # arrays are constants


class Graph:
    """Nodes and constants; both are named by number."""

    def __init__(self, batched: str = "") -> None:
        """Begins an empty one; `batched` names an input whose first axis is a batch."""
        self._batched = batched
        self._nodes: list[Any] = []
        self._constants: dict[tuple[Any, ...], Any] = {}
        self._joined: dict[str, tuple[int, list[Value]]] = {}
        self._reshaped: dict[str, Named] = {}  # what it was before
        self._known: dict[Any, Named] = {}

    def add(self, kind: str, *values: Value, like: Any, **attributes: Any) -> Named:
        """Adds a node of one output, whose shape and dtype are those of `like`."""
        from onnx import helper

        inputs = [self._name(value) for value in values]
        key = (kind, *inputs, *map(str, attributes.items()))
        if key not in self._known:
            name = f"v{len(self._nodes)}"
            self._nodes.append(helper.make_node(kind, inputs, [name], **attributes))
            self._known[key] = Named(name, tuple(like.shape), np.dtype(like.dtype))
        return self._known[key]

    def _name(self, value: Value) -> str:
        from onnx import numpy_helper

        if isinstance(value, Named):
            return value.name
        key = (value.dtype.str, value.shape, value.tobytes())
        if key not in self._constants:
            name = f"c{len(self._constants)}"
            self._constants[key] = numpy_helper.from_array(value, name)
        return self._constants[key].name

    def elementwise(self, kind: str, dtype: Any, *values: Value, **more: Any) -> Named:
        """Adds an operator that broadcasts its values."""
        shape = np.broadcast_shapes(*(value.shape for value in values))
        return self.add(kind, *values, like=jax.ShapeDtypeStruct(shape, dtype), **more)

    def cast(self, value: Value, dtype: Any) -> Value:
        """The value as another dtype."""
        from onnx import helper

        if isinstance(value, np.ndarray):
            return value.astype(dtype)
        if value.dtype == dtype:
            return value
        to = helper.np_dtype_to_tensor_dtype(np.dtype(dtype))
        return self.elementwise("Cast", dtype, value, to=to)

    def reshape(self, value: Value, shape: Sequence[int]) -> Value:
        """The same numbers in another shape."""
        if isinstance(value, np.ndarray):
            return value.reshape(shape)
        before = self._reshaped.get(value.name, value)
        found = self._shaped("Reshape", before, shape)
        if found is not before:
            self._reshaped[found.name] = before
        return found

    def expand(self, value: Value, shape: Sequence[int]) -> Value:
        """The value in the whole shape that it stands for."""
        if value.shape == tuple(shape):
            return value
        if BATCH not in shape:
            if isinstance(value, np.ndarray):
                return np.broadcast_to(value, shape)
            return self._shaped("Expand", value, shape)
        one = jax.ShapeDtypeStruct((1,), np.int64)
        batch = Named(self._batched, (BATCH,), np.int64)
        size = self.add("Shape", batch, like=one, start=0, end=1)
        sizes = [size if n == BATCH else np.array([n], np.int64) for n in shape]
        whole = self.join(sizes, 0, jax.ShapeDtypeStruct((len(shape),), np.int64))
        like = jax.ShapeDtypeStruct(shape, value.dtype)
        return self.add("Expand", value, whole, like=like)

    def transpose(self, value: Value, order: Sequence[int]) -> Value:
        """The axes in another order."""
        if isinstance(value, np.ndarray):
            return value.transpose(order)
        if list(order) == sorted(order):
            return value
        shape = [value.shape[axis] for axis in order]
        like = jax.ShapeDtypeStruct(shape, value.dtype)
        return self.add("Transpose", value, like=like, perm=list(order))

    def join(self, values: Sequence[Value], axis: int, like: Any) -> Named:
        """Concatenates values."""
        found = self.add("Concat", *values, like=like, axis=axis)
        self._joined[found.name] = axis, list(values)
        return found

    def slice(
        self,
        value: Value,
        starts: Sequence[int],
        ends: Sequence[int],
        steps: Sequence[int] | None = None,
    ) -> Value:
        """A part of a value; taken from a joined value if that contains it."""
        steps = steps or [1] * len(starts)
        if isinstance(value, np.ndarray):
            return value[tuple(map(slice, starts, ends, steps))]
        axis, parts = self._joined.get(value.name, (0, []))
        begin = 0
        for part in parts:
            low, high = starts[axis] - begin, ends[axis] - begin
            if 0 <= low < high <= part.shape[axis]:
                starts, ends = (
                    [*bounds[:axis], at, *bounds[axis + 1 :]]
                    for bounds, at in ((starts, low), (ends, high))
                )
                return self.slice(part, starts, ends, steps)
            begin += part.shape[axis]
        shape = [
            -(-(b - a) // step) for a, b, step in zip(starts, ends, steps, strict=True)
        ]
        if tuple(shape) == value.shape:
            return value
        axes = [k for k, size in enumerate(value.shape) if size != shape[k]]
        places = range(len(shape))
        bounds = (np.array(x, np.int64)[axes] for x in (starts, ends, places, steps))
        like = jax.ShapeDtypeStruct(shape, value.dtype)
        return self.add("Slice", value, *bounds, like=like)

    def _shaped(self, kind: str, value: Named, shape: Sequence[int]) -> Named:
        if value.shape == tuple(shape):
            return value
        like = jax.ShapeDtypeStruct(shape, value.dtype)
        sizes = [-1 if n and n % BATCH == 0 else n for n in shape]
        return self.add(kind, value, np.array(sizes, np.int64), like=like)

    def model(self, inputs: Sequence[Named], outputs: Mapping[str, Value]) -> Any:
        """The model (`onnx.ModelProto`), without nodes that no output needs."""
        from onnx import helper

        for name, value in outputs.items():
            node = helper.make_node("Identity", [self._name(value)], [name])
            self._nodes.append(node)
        needed, nodes = set(outputs), []
        for node in reversed(self._nodes):
            if node.output[0] in needed:
                needed.update(node.input)
                nodes.append(node)
        made = helper.make_graph(
            nodes[::-1],
            "carpark_mj",
            [_describe(x.name, x) for x in inputs if self._batched or x.name in needed],
            [_describe(name, value) for name, value in outputs.items()],
            [x for x in self._constants.values() if x.name in needed],
        )
        opset = helper.make_opsetid("", OPSET)
        return helper.make_model(made, opset_imports=[opset], ir_version=IR_VERSION)


def _describe(name: str, value: Any) -> Any:
    from onnx import helper

    kind = helper.np_dtype_to_tensor_dtype(np.dtype(value.dtype))
    shape = ["batch" if size == BATCH else size for size in value.shape]
    return helper.make_tensor_value_info(name, kind, shape)


def make_graph(
    function: Callable[..., Mapping[str, jax.Array]],
    inputs: Mapping[str, jax.ShapeDtypeStruct],
) -> Any:
    """The ONNX model (`onnx.ModelProto`) of a function.

    Args:
        function: of arrays; gives the model's outputs by name.
        inputs: the arrays in order; the model has those that its outputs depend on, or
            all if their first axis is `BATCH`, which stands for any size.

    Raises:
        NotImplementedError: a primitive that the table does not have.
    """
    program, outputs = jax.make_jaxpr(function, return_shape=True)(*inputs.values())
    batched = any(BATCH in x.shape[:1] for x in inputs.values())
    wanted = [True] * len(outputs)
    jaxpr, read = dce_jaxpr(program.jaxpr, wanted, instantiate=batched)
    given = [
        Named(name, x.shape, np.dtype(x.dtype))
        for (name, x), is_read in zip(inputs.items(), read, strict=True)
        if is_read
    ]
    graph = Graph(given[0].name if batched else "")
    found = _run(graph, ClosedJaxpr(jaxpr, program.consts), given)
    whole = {
        name: graph.expand(value, outputs[name].shape)
        for name, value in zip(sorted(outputs), found, strict=True)
    }
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
    whole = [
        graph.expand(value, variable.aval.shape)
        for value, variable in zip(values, eqn.invars, strict=True)
    ]
    if eqn.primitive.multiple_results:
        return _SHAPED[name](graph, shapes, *whole, **params)
    return [_SHAPED[name](graph, shapes[0], *whole, **params)]


def _compute(eqn: Any, values: list[Any]) -> Sequence[Value]:
    """What an equation of constants computes."""
    whole = [
        value
        if value.shape == variable.aval.shape
        else np.broadcast_to(value, variable.aval.shape)
        for value, variable in zip(values, eqn.invars, strict=True)
    ]
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
    length, consts = params["length"], params["num_consts"]
    if length > LONGEST_LOOP or len(values) > consts + params["num_carry"]:
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


def _plain(kind: str) -> Callable[..., Value]:
    def add(graph: Graph, dtype: Any, *values: Value, **params: Any) -> Value:
        del params
        return graph.elementwise(kind, dtype, *values)

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


def _remainder(graph: Graph, dtype: Any, *values: Value) -> Value:
    return graph.elementwise("Mod", dtype, *values, fmod=1)  # of the dividend's sign


def _square(graph: Graph, dtype: Any, value: Value) -> Value:
    return graph.elementwise("Mul", dtype, value, value)


def _power(graph: Graph, dtype: Any, value: Value, y: int) -> Value:
    if y == 2:
        return _square(graph, dtype, value)
    return graph.elementwise("Pow", dtype, value, np.asarray(y, dtype))


def _inverse_root(graph: Graph, dtype: Any, value: Value, **params: Any) -> Value:
    root = graph.elementwise("Sqrt", dtype, value)
    return graph.elementwise("Reciprocal", dtype, root)


def _cast(graph: Graph, dtype: Any, value: Value, **params: Any) -> Value:
    return graph.cast(value, dtype)


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
    **{name: _plain(name.capitalize()) for name in _SAME},
    "clamp": _clamp,
    "convert_element_type": _cast,
    "eq": _plain("Equal"),
    "ge": _plain("GreaterOrEqual"),
    "gt": _plain("Greater"),
    "integer_pow": _power,
    "is_finite": _is_finite,
    "le": _plain("LessOrEqual"),
    "logistic": _plain("Sigmoid"),
    "lt": _plain("Less"),
    "ne": _not_equal,
    "rem": _remainder,
    "rsqrt": _inverse_root,
    "select_n": _select,
    "square": _square,
    "stop_gradient": lambda graph, dtype, value: value,
}


def _reshape(graph: Graph, like: Any, value: Value, **params: Any) -> Value:
    return graph.reshape(value, like.shape)


def _transpose(graph: Graph, like: Any, value: Value, permutation: Any) -> Value:
    return graph.transpose(value, permutation)


def _concatenate(graph: Graph, like: Any, *values: Value, dimension: int) -> Value:
    return graph.join([x for x in values if 0 not in x.shape], dimension, like)


def _stack(graph: Graph, like: Any, *values: Value, axis: int) -> Value:
    shape = [1 if k == axis else size for k, size in enumerate(like.shape)]
    return graph.join([graph.reshape(value, shape) for value in values], axis, like)


def _split(graph: Graph, likes: Any, value: Value, sizes: Any, axis: int) -> Any:
    del likes
    edges = np.cumsum([0, *sizes]).tolist()
    return [_slice_axis(graph, value, axis, *two) for two in itertools.pairwise(edges)]


def _slice(graph: Graph, like: Any, value: Value, **params: Any) -> Value:
    del like
    starts, ends = params["start_indices"], params["limit_indices"]
    return graph.slice(value, starts, ends, params["strides"])


def _slice_axis(graph: Graph, value: Value, axis: int, start: int, end: int) -> Value:
    """What lies from `start` to `end` along an axis."""
    starts, ends = [0] * len(value.shape), list(value.shape)
    starts[axis], ends[axis] = start, end
    return graph.slice(value, starts, ends)


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
            one, other = (
                _slice_axis(graph, value, int(axes[0]), k, k + 1) for k in (0, 1)
            )
            found = graph.elementwise(kind[-3:], like.dtype, one, other)
            return graph.reshape(found, like.shape)
        if value.dtype != bool:
            return graph.add(kind, value, axes, like=like, keepdims=0)
        number = graph.cast(value, np.int32)
        whole = jax.ShapeDtypeStruct(like.shape, np.int32)
        found = graph.add(kind, number, axes, like=whole, keepdims=0)
        return graph.cast(found, bool)

    return add


def _arg_reduce(kind: str) -> Callable[..., Value]:
    def add(graph: Graph, like: Any, value: Value, **params: Any) -> Value:
        [axis] = params["axes"]
        whole = jax.ShapeDtypeStruct(like.shape, np.int64)
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
    like_matrix = jax.ShapeDtypeStruct(shape[shape[0] == 1 :], like.dtype)
    found = graph.add("MatMul", left, right, like=like_matrix)
    return graph.reshape(found, like.shape)


def _gather(graph: Graph, like: Any, value: Value, at: Value, **params: Any) -> Value:
    """Rows of a table: axes that are indexed come in front and are joined into one."""
    numbers, sizes = params["dimension_numbers"], params["slice_sizes"]
    lead, batch = at.shape[:-1], numbers.operand_batching_dims
    starts, moving = [0] * len(value.shape), {}
    for k, axis in enumerate(numbers.start_index_map):
        index = graph.reshape(_slice_axis(graph, at, len(lead), k, k + 1), lead)
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
    shape = jax.ShapeDtypeStruct((*lead, *whole), value.dtype)
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
    "stack": _stack,
    "transpose": _transpose,
}
