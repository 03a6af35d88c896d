"""Rows of numbers seen by name, in compiled and in plain code alike.

What compiled code carries per run is a row, ``float64[…]``: one type whatever it holds, so that functions which know
different rows can stand in each other's place (`apel.numerics.compiled.KernelFunction`). A `Layout` says, in one place,
which named blocks a row opens with; nothing else counts offsets.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Generic, TypeVar

import numpy as np
from numba import types
from numba.core import cgutils
from numba.extending import lower_builtin, type_callable
from numpy.typing import NDArray

Row = NDArray[np.float64]
View = TypeVar("View", bound=tuple[Any, ...])

PER_LEARNER, REST = -1, -2
"""Sizes of a block: one number per learner; all that is left of the row."""


class Layout(Generic[View]):
    """Which blocks rows open with.

    Parameters
    ----------
    view:
        A NamedTuple of arrays: the blocks, in the order of the row.
    sizes:
        How many numbers a block has, where it is not one per learner. Only the last one may be the `REST`.

    Attributes
    ----------
    view:
        ``(row, num_learners) → View``: the blocks, which share the row's memory. A plain function that compiled code
        can call, where the row must outlive its blocks; plain code may also pass rows with leading dimensions.
    """

    def __init__(self, view: type[View], **sizes: int) -> None:
        self.names: tuple[str, ...] = view._fields  # type: ignore[attr-defined]
        if unknown := sizes.keys() - set(self.names):
            message = f"found sizes of {sorted(unknown)}, expected sizes of {self.names}"
            raise ValueError(message)
        self._sizes = tuple(sizes.get(name, PER_LEARNER) for name in self.names)
        self.view: Callable[[Row, int], View] = _block_view(view, self._sizes)

    def size(self, num_learners: int) -> int:
        """Numbers in a row, of the `REST` none."""
        return sum(num_learners if size == PER_LEARNER else max(size, 0) for size in self._sizes)

    def row(self, num_learners: int, **values: float | Sequence[float] | Row) -> Row:
        """A new row: each block all of one value or with the values given, 0 where there are none.

        Raises
        ------
        TypeError
            If a value is for a block that there is not.
        """
        if unknown := values.keys() - set(self.names):
            message = f"found values of {sorted(unknown)}, expected values of {self.names}"
            raise TypeError(message)
        rest = np.size(values.get(self.names[-1], ())) if self._sizes[-1] == REST else 0
        row = np.zeros(self.size(num_learners) + rest)
        for name, block in zip(self.names, self.view(row, num_learners), strict=True):
            block[:] = values.get(name, 0.0)
        return row


def _block_view(view: type[View], sizes: tuple[int, ...]) -> Callable[[Row, int], View]:
    def blocks(row: Row, num_learners: int) -> View:
        cut, begin = [], 0
        for size in sizes:
            end = row.shape[-1] if size == REST else begin + (num_learners if size == PER_LEARNER else size)
            cut.append(row[..., begin:end])
            begin = end
        return view(*cut)

    type_callable(blocks)(lambda _: lambda row, num_learners: types.NamedUniTuple(row, len(sizes), view))  # noqa: ARG005

    @lower_builtin(blocks, types.float64[::1], types.Integer)
    def compiled(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        array_type, integer_type = signature.args
        make_array = context.make_array(array_type)
        whole = make_array(context, builder, arguments[0])
        per_learner = context.cast(builder, arguments[1], integer_type, types.intp)
        cut, begin = [], context.get_constant(types.intp, 0)
        for size in sizes:
            length = per_learner if size == PER_LEARNER else context.get_constant(types.intp, size)
            length = builder.sub(whole.nitems, begin) if size == REST else length
            block = make_array(context, builder, arguments[0])
            block.data = builder.gep(whole.data, [begin])
            block.nitems, block.shape = length, cgutils.pack_array(builder, [length])
            # Borrowed, not owned: to count references to each block, atomically, would cost more than most rules.
            block.meminfo = cgutils.get_null_value(block.meminfo.type)
            block.parent = cgutils.get_null_value(block.parent.type)
            cut.append(block._getvalue())
            begin = builder.add(begin, length)
        return context.make_tuple(builder, signature.return_type, cut)

    return blocks


def named_numbers(view: type[View]) -> Callable[[Row], View]:
    """``row → View``: the numbers that a row, ``float64[fields …]``, opens with, as a NamedTuple of floats.

    A plain function that compiled code can call.
    """
    num_fields = len(view._fields)  # type: ignore[attr-defined]

    def numbers(row: Row) -> View:
        return view(*row[:num_fields].tolist())

    type_callable(numbers)(lambda _: lambda row: types.NamedUniTuple(row.dtype, num_fields, view))

    @lower_builtin(numbers, types.float64[::1])
    def compiled(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        data = context.make_array(signature.args[0])(context, builder, arguments[0]).data
        places = (builder.gep(data, [context.get_constant(types.intp, i)]) for i in range(num_fields))
        return context.make_tuple(builder, signature.return_type, [builder.load(place) for place in places])

    return numbers
