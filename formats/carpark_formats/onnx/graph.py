"""The nodes and constants of an ONNX model.

Shapes are static but for a batch. A value may have a smaller shape than it stands for
if it broadcasts to that shape, because operators broadcast.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from jax import ShapeDtypeStruct as Form

OPSET, IR_VERSION = 18, 8  # onnxruntime takes them from 1.14 on
# The batch's size while a program is translated; no other size is a multiple of it.
BATCH = 7919


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
        import onnx  # only where a model is made

        self._make, self._constant = onnx.helper, onnx.numpy_helper.from_array
        self._batched = batched
        self._nodes: list[Any] = []
        self._constants: dict[tuple[Any, ...], Any] = {}
        self._joined: dict[str, tuple[int, list[Value]]] = {}
        self._reshaped: dict[str, Named] = {}  # what it was before
        self._known: dict[Any, Named] = {}

    def add(self, kind: str, *values: Value, like: Any, **attributes: Any) -> Named:
        """Adds a node of one output, whose shape and dtype are those of `like`."""
        inputs = [self._name(value) for value in values]
        key = (kind, *inputs, *map(str, attributes.items()))
        if key not in self._known:
            name = f"v{len(self._nodes)}"
            self._nodes.append(self._make.make_node(kind, inputs, [name], **attributes))
            self._known[key] = Named(name, tuple(like.shape), np.dtype(like.dtype))
        return self._known[key]

    def _name(self, value: Value) -> str:
        if isinstance(value, Named):
            return value.name
        key = (value.dtype.str, value.shape, value.tobytes())
        if key not in self._constants:
            name = f"c{len(self._constants)}"
            self._constants[key] = self._constant(value, name)
        return self._constants[key].name

    def elementwise(self, kind: str, dtype: Any, *values: Value, **more: Any) -> Named:
        """Adds an operator that broadcasts its values."""
        shape = np.broadcast_shapes(*(value.shape for value in values))
        return self.add(kind, *values, like=Form(shape, dtype), **more)

    def cast(self, value: Value, dtype: Any) -> Value:
        """The value as another dtype."""
        if isinstance(value, np.ndarray):
            return value.astype(dtype)
        if value.dtype == dtype:
            return value
        to = self._make.np_dtype_to_tensor_dtype(np.dtype(dtype))
        return self.elementwise("Cast", dtype, value, to=to)

    def reshape(self, value: Value, shape: Sequence[int]) -> Value:
        """The numbers in another shape."""
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
        batch = Named(self._batched, (BATCH,), np.int64)
        size = self.add("Shape", batch, like=Form((1,), np.int64), start=0, end=1)
        sizes = [size if n == BATCH else np.array([n], np.int64) for n in shape]
        whole = self.join(sizes, 0, Form((len(shape),), np.int64))
        return self.add("Expand", value, whole, like=Form(shape, value.dtype))

    def transpose(self, value: Value, order: Sequence[int]) -> Value:
        """The axes in another order."""
        if isinstance(value, np.ndarray):
            return value.transpose(order)
        if list(order) == sorted(order):
            return value
        like = Form([value.shape[axis] for axis in order], value.dtype)
        return self.add("Transpose", value, like=like, perm=list(order))

    def join(self, values: Sequence[Value], axis: int, like: Any) -> Named:
        """Concatenates values."""
        found = self.add("Concat", *values, like=like, axis=axis)
        self._joined[found.name] = axis, list(values)
        return found

    def slice(self, value: Value, starts: Any, ends: Any, steps: Any = None) -> Value:
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
        bounds = zip(starts, ends, steps, strict=True)
        shape = [-(-(end - start) // step) for start, end, step in bounds]
        if tuple(shape) == value.shape:
            return value
        axes = [k for k, size in enumerate(value.shape) if size != shape[k]]
        places = range(len(shape))
        bounds = (np.array(x, np.int64)[axes] for x in (starts, ends, places, steps))
        return self.add("Slice", value, *bounds, like=Form(shape, value.dtype))

    def part(self, value: Value, axis: int, start: int, end: int) -> Value:
        """What lies from `start` to `end` along an axis."""
        starts, ends = [0] * len(value.shape), list(value.shape)
        starts[axis], ends[axis] = start, end
        return self.slice(value, starts, ends)

    def _shaped(self, kind: str, value: Named, shape: Sequence[int]) -> Named:
        if value.shape == tuple(shape):
            return value
        sizes = np.array([-1 if n and n % BATCH == 0 else n for n in shape], np.int64)
        return self.add(kind, value, sizes, like=Form(shape, value.dtype))

    def model(self, inputs: Sequence[Named], outputs: Mapping[str, Value]) -> Any:
        """The model (`onnx.ModelProto`), without nodes that no output needs."""
        make = self._make
        for name, value in outputs.items():
            node = make.make_node("Identity", [self._name(value)], [name])
            self._nodes.append(node)
        needed, nodes = set(outputs), []
        for node in reversed(self._nodes):
            if node.output[0] in needed:
                needed.update(node.input)
                nodes.append(node)
        kept = [x for x in inputs if self._batched or x.name in needed]
        made = make.make_graph(
            nodes[::-1],
            "carpark_mj",
            [self._described(value.name, value) for value in kept],
            [self._described(name, value) for name, value in outputs.items()],
            [x for x in self._constants.values() if x.name in needed],
        )
        opsets = [make.make_opsetid("", OPSET)]
        return make.make_model(made, opset_imports=opsets, ir_version=IR_VERSION)

    def _described(self, name: str, value: Value) -> Any:
        kind = self._make.np_dtype_to_tensor_dtype(np.dtype(value.dtype))
        shape = ["batch" if size == BATCH else size for size in value.shape]
        return self._make.make_tensor_value_info(name, kind, shape)
