"""Straight-line programs: a formula written once on symbols, then run on columns of numbers.

Arithmetic on a `Symbol` computes nothing but writes a step of a program. A step is written once
however often the formula asks for it, and a change of sign waits for the sum that it belongs to. A
program runs on NumPy arrays in chunks that fit the cache, in buffers that later steps use again.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from stiff_protocols.contract.types import FloatArray

CHUNK = 6144
"""Rows a pass: enough to hide the cost of a NumPy call, few enough for a core's own cache."""

Operand = int | str
"""Number of a value (the inputs, then every step's), or a constant as text."""

_UFUNCS: dict[str, Any] = {
    "+": np.add,
    "-": np.subtract,
    "*": np.multiply,
    "/": np.divide,
    "tan": np.tan,
}


@dataclass(frozen=True)
class Step:
    """One operation on one or two operands."""

    name: str
    operands: tuple[Operand, ...]


class Tape:
    """Where symbols write their steps.

    Attributes:
        n_inputs: number of inputs.
        steps: in the order in which they were first asked for.
    """

    def __init__(self, n_inputs: int) -> None:
        """Start an empty program."""
        self.n_inputs = n_inputs
        self.steps: list[Step] = []
        self._values: dict[Step, int] = {}

    def value(self, name: str, *operands: Operand) -> Symbol:
        """Return the symbol of a step, which is written unless it stands there."""
        step = Step(name, operands)
        if step not in self._values:
            self._values[step] = self.n_inputs + len(self.steps)
            self.steps.append(step)
        return Symbol(self, self._values[step])


@dataclass(frozen=True, eq=False, slots=True)
class Symbol:
    """A value of a program, or its opposite."""

    tape: Tape
    number: int
    negative: bool = False

    def __neg__(self) -> Symbol:
        """Write no step: the sign waits."""
        return Symbol(self.tape, self.number, not self.negative)

    def __add__(self, other: Symbol | float) -> Symbol:
        """Write a sum, or the difference that it is."""
        operand, negative = _operand(other)
        if self.negative and negative:
            return -self.tape.value("+", self.number, operand)
        if self.negative:
            return self.tape.value("-", operand, self.number)
        return self.tape.value("-" if negative else "+", self.number, operand)

    def __radd__(self, other: float) -> Symbol:
        """Write a sum."""
        return self + other

    def __sub__(self, other: Symbol | float) -> Symbol:
        """Write a difference."""
        return self + -other

    def __rsub__(self, other: float) -> Symbol:
        """Write a difference."""
        return -self + other

    def __mul__(self, other: Symbol | float) -> Symbol:
        """Write a product of the values without their signs."""
        operand, negative = _operand(other)
        product = self.tape.value("*", self.number, operand)
        return product if negative == self.negative else -product

    def __rmul__(self, other: float) -> Symbol:
        """Write a product."""
        return self * other

    def __rtruediv__(self, other: float) -> Symbol:
        """Write a quotient."""
        operand, negative = _operand(other)
        quotient = self.tape.value("/", operand, self.number)
        return quotient if negative == self.negative else -quotient


def tape_with(*sizes: int) -> tuple[Tape, list[list[Symbol]]]:
    """Return an empty program and symbols for its inputs, in groups of these sizes."""
    tape = Tape(sum(sizes))
    numbers = iter(range(tape.n_inputs))
    return tape, [[Symbol(tape, next(numbers)) for _ in range(size)] for size in sizes]


def _operand(value: Symbol | float) -> tuple[Operand, bool]:
    if isinstance(value, Symbol):
        return value.number, value.negative
    return repr(abs(float(value))), value < 0.0


def half_angle(angle: Symbol) -> tuple[Symbol, Symbol]:
    """Return cosine and sine by the tangent of the half angle: one transcendental step of two.

    Of NumPy's trigonometric functions in float64 the tangent alone is vectorised; the error is
    below 6e-16.
    """
    half = 0.5 * angle
    tangent = half.tape.value("tan", half.number)
    if half.negative:
        tangent = -tangent
    double = 2.0 / (1.0 + tangent * tangent)
    return double - 1.0, tangent * double


@dataclass(frozen=True, eq=False)
class Program:
    """Steps on arrays, with the places where each finds its operands and leaves its value.

    Attributes:
        n_inputs: number of inputs.
        n_results: number of results.
        constants: of the steps.
        n_buffers: how many arrays the values between need.
        steps: function and places; places are numbered through inputs, results, constants and
            buffers.
    """

    n_inputs: int
    n_results: int
    constants: tuple[float, ...]
    n_buffers: int
    steps: tuple[tuple[Any, tuple[int, ...]], ...]

    @classmethod
    def of(cls, tape: Tape, results: Sequence[Symbol | float]) -> Program:
        """Arrange the steps that lead to `results`."""
        return _Arrangement(tape, results).program()

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
                inputs, results, calls = self._bound(min(CHUNK, n - start), shared)
            row = 0
            for array in columns:
                inputs[row : row + array.shape[1]] = array[part].T
                row += array.shape[1]
            for function, arguments in calls:
                function(*arguments)
            out[:, part] = results

    def _bound(
        self, size: int, shared: Sequence[float]
    ) -> tuple[FloatArray, FloatArray, list[tuple[Any, list[FloatArray]]]]:
        """Return arrays for the inputs (n_columns, size) and the results, and the steps on them."""
        inputs = np.empty((self.n_inputs - len(shared), size))
        results = np.empty((self.n_results, size))
        constants = [np.asarray(value) for value in (*shared, *self.constants)]
        given, own = constants[: len(shared)], constants[len(shared) :]
        places = [*inputs, *given, *results, *own, *np.empty((self.n_buffers, size))]
        calls = [(function, [places[k] for k in numbers]) for function, numbers in self.steps]
        return inputs, results, calls


class _Arrangement:
    """Gives every value a place; a buffer is free again after the last step that reads it."""

    def __init__(self, tape: Tape, results: Sequence[Symbol | float]) -> None:
        self._tape, self._results = tape, results
        self._places = {number: ("input", number) for number in range(tape.n_inputs)}
        self._constants: dict[str, int] = {}
        self._free: list[int] = []
        self._n_buffers = 0

    def program(self) -> Program:
        needed = _needed(self._tape, self._results)
        last = {operand: i for i, (_, step) in enumerate(needed) for operand in step.operands}
        own = self._own_results()
        kept = {result.number for result in self._results if isinstance(result, Symbol)}
        steps = []
        for i, (number, step) in enumerate(needed):
            places = [self._place(operand) for operand in step.operands]
            for operand in set(step.operands) - kept:
                if last[operand] == i and self._place(operand)[0] == "buffer":
                    self._free.append(self._place(operand)[1])
            self._places[number] = ("result", own[number]) if number in own else self._buffer()
            steps.append((_UFUNCS[step.name], [*places, self._places[number]]))
        for i, result in enumerate(self._results):
            operand, negative = _operand(result)
            if self._place(operand) != ("result", i):
                function = np.negative if negative else np.positive
                steps.append((function, [self._place(operand), ("result", i)]))
        return self._numbered(steps)

    def _own_results(self) -> dict[int, int]:
        """Values that can be written straight to where the caller wants them."""
        return {
            result.number: i
            for i, result in enumerate(self._results)
            if isinstance(result, Symbol)
            and not result.negative
            and result.number >= self._tape.n_inputs
        }

    def _place(self, operand: Operand) -> tuple[str, int]:
        if isinstance(operand, int):
            return self._places[operand]
        return "constant", self._constants.setdefault(operand, len(self._constants))

    def _buffer(self) -> tuple[str, int]:
        if self._free:
            return "buffer", self._free.pop()
        self._n_buffers += 1
        return "buffer", self._n_buffers - 1

    def _numbered(self, steps: list[tuple[Any, list[tuple[str, int]]]]) -> Program:
        first = {"input": 0, "result": self._tape.n_inputs}
        first["constant"] = first["result"] + len(self._results)
        first["buffer"] = first["constant"] + len(self._constants)
        return Program(
            n_inputs=self._tape.n_inputs,
            n_results=len(self._results),
            constants=tuple(float(text) for text in self._constants),
            n_buffers=self._n_buffers,
            steps=tuple(
                (function, tuple(first[kind] + number for kind, number in places))
                for function, places in steps
            ),
        )


def _needed(tape: Tape, results: Sequence[Symbol | float]) -> list[tuple[int, Step]]:
    """Return the steps that the results depend on, with the numbers of their values."""
    wanted = {result.number for result in results if isinstance(result, Symbol)}
    found = []
    for i in reversed(range(len(tape.steps))):
        number, step = tape.n_inputs + i, tape.steps[i]
        if number in wanted:
            found.append((number, step))
            wanted.update(operand for operand in step.operands if isinstance(operand, int))
    return found[::-1]
