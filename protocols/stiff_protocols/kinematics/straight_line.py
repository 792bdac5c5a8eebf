"""Straight-line programs: a formula written once on symbols, then run on columns of numbers.

Arithmetic on a `Symbol` computes nothing but writes a step of a program. A step is written once
however often the formula asks for it. A program runs on NumPy arrays in chunks that fit the cache,
in buffers that later steps use again.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from stiff_protocols.contract.arrays import FloatArray

CHUNK = 6144
"""Rows a pass: enough to hide the cost of a NumPy call, few enough for a core's own cache."""

Operand = int | str
"""Number of a value (the inputs, then every step's), or a constant as text."""


Step = tuple[np.ufunc, tuple[Operand, ...]]
"""One operation on one or two operands."""


@dataclass(frozen=True, eq=False)
class Tape:
    """Where symbols write their steps.

    Attributes:
        n_inputs: number of inputs.
        steps: each once, in the order in which they were first asked for -> number of its value.
    """

    n_inputs: int
    steps: dict[Step, int] = field(default_factory=dict)

    def value(self, function: np.ufunc, *operands: Operand) -> Symbol:
        """Return the symbol of a step, which is written unless it stands there."""
        new = self.n_inputs + len(self.steps)
        return Symbol(self, self.steps.setdefault((function, operands), new))


@dataclass(frozen=True, eq=False, slots=True)
class Symbol:
    """A value of a program; arithmetic on it writes a step."""

    tape: Tape
    number: int

    def __neg__(self) -> Symbol:
        return self.tape.value(np.negative, self.number)

    def __add__(self, other: Symbol | float) -> Symbol:
        return self.tape.value(np.add, self.number, _operand(other))

    __radd__ = __add__

    def __sub__(self, other: Symbol | float) -> Symbol:
        return self.tape.value(np.subtract, self.number, _operand(other))

    def __rsub__(self, other: float) -> Symbol:
        return self.tape.value(np.subtract, _operand(other), self.number)

    def __mul__(self, other: Symbol | float) -> Symbol:
        return self.tape.value(np.multiply, self.number, _operand(other))

    __rmul__ = __mul__

    def __rtruediv__(self, other: float) -> Symbol:
        return self.tape.value(np.divide, _operand(other), self.number)


def tape_with(*sizes: int) -> tuple[Tape, list[list[Symbol]]]:
    """Return an empty program and symbols for its inputs, in groups of these sizes."""
    tape = Tape(sum(sizes))
    numbers = iter(range(tape.n_inputs))
    return tape, [[Symbol(tape, next(numbers)) for _ in range(size)] for size in sizes]


def _operand(value: Symbol | float) -> Operand:
    return value.number if isinstance(value, Symbol) else repr(float(value))


def half_angle(angle: Symbol) -> tuple[Symbol, Symbol]:
    """Return cosine and sine by the tangent of the half angle: one transcendental step of two.

    Of NumPy's trigonometric functions in float64 the tangent alone is vectorised; the error is
    below 6e-16.
    """
    half = 0.5 * angle
    tangent = half.tape.value(np.tan, half.number)
    double = 2.0 / (1.0 + tangent * tangent)
    return double - 1.0, tangent * double


@dataclass(frozen=True, eq=False)
class Program:
    """Steps on arrays, with the places where each finds its operands and leaves its value.

    Attributes:
        n_inputs: number of inputs, which have the first places.
        others: contents of the other places: a constant's value, or None for an array.
        steps: function and numbers of the places.
        results: place of each result.
    """

    n_inputs: int
    others: tuple[float | None, ...]
    steps: tuple[tuple[np.ufunc, tuple[int, ...]], ...]
    results: tuple[int, ...]

    @classmethod
    def of(cls, tape: Tape, results: Sequence[Symbol | float]) -> Program:
        """Arrange the steps that lead to `results`; arrays that no later step reads serve again."""
        places: dict[Operand, int] = {number: number for number in range(tape.n_inputs)}
        others: list[float | None] = []
        unread: list[int] = []
        steps: list[tuple[np.ufunc, tuple[int, ...]]] = []

        def new_place(content: float | None) -> int:
            others.append(content)
            return tape.n_inputs + len(others) - 1

        def place_of(operand: Operand) -> int:
            if operand not in places:  # a constant
                places[operand] = new_place(float(operand))
            return places[operand]

        wanted = [_operand(result) for result in results]
        kept = set(wanted)
        needed = _needed(tape, kept)
        last = {operand: i for i, (_, (_, each)) in enumerate(needed) for operand in each}
        for i, (number, (function, operands)) in enumerate(needed):
            read_places = [place_of(operand) for operand in operands]
            for operand in set(operands) - kept:
                if last[operand] == i and isinstance(operand, int) and operand >= tape.n_inputs:
                    unread.append(places[operand])
            places[number] = unread.pop() if unread else new_place(None)
            steps.append((function, (*read_places, places[number])))
        ends = tuple(map(place_of, wanted))
        return cls(tape.n_inputs, tuple(others), tuple(steps), ends)

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
                calls = [(function, [places[k] for k in each]) for function, each in self.steps]
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
        between = iter(np.empty((self.others.count(None), size)))
        others = [next(between) if value is None else np.asarray(value) for value in self.others]
        return inputs, [*inputs, *map(np.asarray, shared), *others]


def _needed(tape: Tape, results: set[Operand]) -> list[tuple[int, Step]]:
    """Return the steps that these values depend on, with the numbers of their own values."""
    wanted, needed_steps = set(results), []
    for step, number in reversed(tape.steps.items()):
        if number in wanted:
            needed_steps.append((number, step))
            wanted.update(step[1])
    return needed_steps[::-1]
