"""Straight-line programs: a formula written once on symbols, then run on columns of numbers.

Arithmetic on a `Symbol` only writes a step of a program. Equal steps are written once. A program
runs on NumPy arrays in chunks that fit the cache, in buffers that later steps reuse.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from stiff_protocols.contract.arrays import FloatArray

CHUNK = 6144
"""Rows per pass: enough to hide the cost of a NumPy call, few enough for a core's cache."""

Operand = int | str
"""Number of a value (the inputs, then every step's), or a constant as text."""


Step = tuple[np.ufunc, tuple[Operand, ...]]
"""One operation on one or two operands."""


@dataclass(frozen=True, eq=False)
class Tape:
    """Steps of a program that symbols write.

    Attributes:
        n_inputs: number of inputs.
        steps: distinct steps in the order of their first use -> number of the value.
    """

    n_inputs: int
    steps: dict[Step, int] = field(default_factory=dict)

    def value(self, function: np.ufunc, *operands: Operand) -> Symbol:
        """Return the symbol of a step, which is written if it is new."""
        new = self.n_inputs + len(self.steps)
        return Symbol(self, self.steps.setdefault((function, operands), new))


@dataclass(frozen=True, eq=False, slots=True)
class Symbol:
    """A value of a program; arithmetic on it writes a step."""

    tape: Tape
    number: int

    def __neg__(self) -> Symbol:
        return self.tape.value(np.negative, self.number)

    def __add__(self, summand: Symbol | float) -> Symbol:
        return self.tape.value(np.add, self.number, _operand(summand))

    __radd__ = __add__

    def __sub__(self, subtrahend: Symbol | float) -> Symbol:
        return self.tape.value(np.subtract, self.number, _operand(subtrahend))

    def __rsub__(self, minuend: float) -> Symbol:
        return self.tape.value(np.subtract, _operand(minuend), self.number)

    def __mul__(self, factor: Symbol | float) -> Symbol:
        return self.tape.value(np.multiply, self.number, _operand(factor))

    __rmul__ = __mul__

    def __rtruediv__(self, dividend: float) -> Symbol:
        return self.tape.value(np.divide, _operand(dividend), self.number)


def tape_with(*sizes: int) -> tuple[Tape, list[list[Symbol]]]:
    """Return an empty program and symbols for its inputs, in groups of these sizes."""
    tape = Tape(sum(sizes))
    numbers = iter(range(tape.n_inputs))
    return tape, [[Symbol(tape, next(numbers)) for _ in range(size)] for size in sizes]


def _operand(value: Symbol | float) -> Operand:
    return value.number if isinstance(value, Symbol) else repr(float(value))


def half_angle(angle: Symbol) -> tuple[Symbol, Symbol]:
    """Return cosine and sine by the tangent of the half angle: one transcendental step, not two.

    Of NumPy's trigonometric functions in float64 only the tangent is vectorised; the error is
    below 6e-16.
    """
    half = 0.5 * angle
    tangent = half.tape.value(np.tan, half.number)
    double = 2.0 / (1.0 + tangent * tangent)
    return double - 1.0, tangent * double


@dataclass(frozen=True, eq=False)
class Program:
    """Steps on arrays, with the places of their operands and values.

    Attributes:
        n_inputs: number of inputs, which have the first places.
        other_contents: contents of the other places: a constant's value, or None for an array.
        steps: function and numbers of the places.
        results: place of each result.
    """

    n_inputs: int
    other_contents: tuple[float | None, ...]
    steps: tuple[tuple[np.ufunc, tuple[int, ...]], ...]
    results: tuple[int, ...]

    @classmethod
    def of(cls, tape: Tape, results: Sequence[Symbol | float]) -> Program:
        """Arrange the steps for `results`; arrays that no later step reads are reused."""
        places: dict[Operand, int] = {number: number for number in range(tape.n_inputs)}
        contents: list[float | None] = []
        unread: list[int] = []
        steps: list[tuple[np.ufunc, tuple[int, ...]]] = []

        def new_place(content: float | None) -> int:
            contents.append(content)
            return tape.n_inputs + len(contents) - 1

        def place_of(operand: Operand) -> int:
            if operand not in places:  # a constant
                places[operand] = new_place(float(operand))
            return places[operand]

        result_operands = [_operand(result) for result in results]
        result_set = set(result_operands)
        needed = _needed(tape, result_set)
        last = {operand: i for i, (_, (_, operands)) in enumerate(needed) for operand in operands}
        for i, (number, (function, operands)) in enumerate(needed):
            read_places = [place_of(operand) for operand in operands]
            for operand in set(operands) - result_set:
                if last[operand] == i and isinstance(operand, int) and operand >= tape.n_inputs:
                    unread.append(places[operand])
            places[number] = unread.pop() if unread else new_place(None)
            steps.append((function, (*read_places, places[number])))
        ends = tuple(map(place_of, result_operands))
        return cls(tape.n_inputs, tuple(contents), tuple(steps), ends)

    def run(
        self, columns: Sequence[FloatArray], out: FloatArray, shared: Sequence[float] = ()
    ) -> None:
        """Compute the results.

        Args:
            columns: (n, k) arrays whose columns are the first inputs.
            out: (n_results, n), written; of any strides.
            shared: the last inputs, which are the same for all n.
        """
        n = out.shape[1]
        for start in range(0, n, CHUNK):
            part = slice(start, start + CHUNK)
            if start == 0 or n - start < CHUNK:
                inputs, places = self._places(min(CHUNK, n - start), shared)
                calls = [
                    (function, [places[k] for k in step_places])
                    for function, step_places in self.steps
                ]
            row = 0
            for array in columns:
                inputs[row : row + array.shape[1]] = array[part].T
                row += array.shape[1]
            for function, arguments in calls:
                function(*arguments)
            for result, place in zip(out, self.results, strict=True):
                result[part] = places[place]

    def _places(self, size: int, shared: Sequence[float]) -> tuple[FloatArray, list[FloatArray]]:
        """Return an array for the inputs (n_columns, size), and the contents of all places."""
        inputs = np.empty((self.n_inputs - len(shared), size))
        between = iter(np.empty((self.other_contents.count(None), size)))
        other_places = [
            next(between) if value is None else np.asarray(value) for value in self.other_contents
        ]
        return inputs, [*inputs, *map(np.asarray, shared), *other_places]


def _needed(tape: Tape, results: set[Operand]) -> list[tuple[int, Step]]:
    """Return the steps that these values depend on, with the numbers of their own values."""
    needed_values, needed_steps = set(results), []
    for step, number in reversed(tape.steps.items()):
        if number in needed_values:
            needed_steps.append((number, step))
            needed_values.update(step[1])
    return needed_steps[::-1]
