"""ONNX graph: numpy's functions on symbols, recorded as the nodes of a graph.

A symbol stands for an array whose first axis is the rows of a batch. What is called with symbols in
the place of arrays is written down operation by operation, in its order.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import EllipsisType, ModuleType
from typing import Any

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin
from numpy.typing import NDArray

from trueup.errors import NotExportable

OPERATORS: Mapping[str, str] = {
    "add": "Add", "subtract": "Sub", "multiply": "Mul", "divide": "Div", "negative": "Neg",
    "matmul": "MatMul", "absolute": "Abs", "sign": "Sign",
    "minimum": "Min", "maximum": "Max", "sin": "Sin", "cos": "Cos", "exp": "Exp", "rint": "Round",
    "greater": "Greater", "less": "Less", "greater_equal": "GreaterOrEqual",
    "less_equal": "LessOrEqual", "equal": "Equal",
}  # fmt: skip
COMPARISONS = ("Greater", "Less", "GreaterOrEqual", "LessOrEqual", "Equal")
Index = int | list[int] | slice | None  # the slice is the whole axis


class Graph:
    """Nodes in the order in which they were recorded, and constants by value."""

    def __init__(self, onnx: ModuleType) -> None:
        self._onnx, self._nodes = onnx, list[Any]()
        self._constants = dict[tuple[str, tuple[int, ...], bytes], Any]()

    def column(self, source: str, number: int) -> Symbol:
        """A column `(n,)` of an input."""
        place = self.integers(number)
        return self.apply("Gather", [Symbol(self, source, 2), place], 1, axis=1)

    def output(self, columns: Sequence[Any], like: Symbol, name: str) -> None:
        """Columns beside each other as an output; one number for all rows becomes a column."""
        filled = [x if isinstance(x, Symbol) else like * 0.0 + x for x in columns]
        wide = [x[..., None] for x in filled]
        self._nodes.append(
            self._onnx.helper.make_node("Concat", [x.name for x in wide], [name], axis=1)
        )

    def apply(
        self, operator: str, inputs: Sequence[Any], ndim: int | None = None, **attributes: Any
    ) -> Symbol:
        """The result of an operator on symbols and arrays; it has the dimensions of the largest,
        where `ndim` does not say how many."""
        operands = [x if isinstance(x, Symbol) else self._constant(_floats(x)) for x in inputs]
        if operator != "Cast" and not (operator == "Equal" and all(x.is_truth for x in operands)):
            operands = [
                self.apply("Cast", [x], to=self._onnx.TensorProto.DOUBLE) if x.is_truth else x
                for x in operands
            ]
        name = f"x{len(self._nodes)}"
        self._nodes.append(
            self._onnx.helper.make_node(operator, [x.name for x in operands], [name], **attributes)
        )
        dimensions = max(x.ndim for x in operands) if ndim is None else ndim
        return Symbol(self, name, dimensions, is_truth=operator in COMPARISONS)

    def integers(self, values: int | Sequence[int]) -> Symbol:
        """Integers, as operators take places and axes."""
        return self._constant(np.asarray(values, np.int64))

    def _constant(self, value: NDArray[Any] | np.generic) -> Symbol:
        array = np.asarray(value)
        key = str(array.dtype), array.shape, array.tobytes()
        if key not in self._constants:
            name = f"c{len(self._constants)}"
            self._constants[key] = self._onnx.numpy_helper.from_array(array, name)
        return Symbol(self, self._constants[key].name, array.ndim)

    def needed(self, outputs: Sequence[str]) -> tuple[list[Any], list[Any]]:
        """The nodes, and the constants as initializers, that outputs depend on."""
        wanted, nodes = set(outputs), []
        for node in reversed(self._nodes):
            if wanted.intersection(node.output):
                wanted.update(node.input)
                nodes.append(node)
        return nodes[::-1], [x for x in self._constants.values() if x.name in wanted]


def _floats(x: Any) -> NDArray[np.float64]:
    return np.asarray(x, np.float64)


class Symbol(NDArrayOperatorsMixin):
    """An array that the graph will have, of so many dimensions. numpy's functions on it are
    recorded as nodes; places are taken along its last axes alone, `x[..., 0, None]`."""

    def __init__(self, graph: Graph, name: str, ndim: int, *, is_truth: bool = False) -> None:
        self.graph, self.name, self.ndim, self.is_truth = graph, name, ndim, is_truth

    def __bool__(self) -> bool:
        raise NotExportable("an effect decides by a value in a way that no graph can hold")

    def __getitem__(self, key: tuple[EllipsisType | Index, ...]) -> Symbol:
        indices: list[Any] = [x for x in key if x is not Ellipsis]
        axis, taken = self.ndim - sum(x is not None for x in indices), self
        for index in indices:
            if index is None:
                at = self.graph.integers([axis])
                taken = self.graph.apply("Unsqueeze", [taken, at], taken.ndim + 1)
            elif not isinstance(index, slice):
                less = 0 if isinstance(index, list) else 1
                places = self.graph.integers(index)
                taken = self.graph.apply("Gather", [taken, places], taken.ndim - less, axis=axis)
            axis += 0 if isinstance(index, int) else 1
        return taken

    def __array_ufunc__(self, function: np.ufunc, method: str, *inputs: Any, **more: Any) -> Symbol:
        if (
            method != "__call__"
            or more
            or (function is not np.copysign and function.__name__ not in OPERATORS)
        ):
            raise NotExportable(
                f"an effect uses {function.__name__}, which is not written down here"
            )
        if (
            function is np.copysign
        ):  # of what is not negative, where a zero's own sign does not matter
            size, sign = inputs
            return self.graph.apply("Mul", [size, np.sign(sign)])
        return self.graph.apply(OPERATORS[function.__name__], list(inputs))

    def __array_function__(self, function: Any, _: Any, given: Any, more: Any) -> Any:
        if function is np.ndim:
            return self.ndim
        if function is np.stack:
            arrays, axis = given
            parts = [x[(..., None, *((slice(None),) * (-1 - axis)))] for x in arrays]
            return self.graph.apply("Concat", parts, axis=axis)
        if function is np.swapaxes:
            array, one, other = given
            order = list(range(array.ndim))
            order[one], order[other] = order[other], order[one]
            return self.graph.apply("Transpose", [array], perm=order)
        raise NotExportable(f"an effect uses {function.__name__}, which is not written down here")
