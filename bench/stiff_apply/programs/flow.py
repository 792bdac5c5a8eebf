"""Follow the statements of a program, and know which state holds at each motion.

A language yields items: motions, settings of the state, jumps and calls. The state maps keys, such
as "base" or "tool", to values. After branches, loops, labels and calls a value remains only if all
ways to that place agree; else it is `Unknown` with its cause.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from heapq import heappop, heappush
from typing import Any, NamedTuple


class Frame(NamedTuple):
    """A tool or base frame: its name, and position and orientation in the program's units.

    Without values the frame is in the controller.
    """

    name: str
    values: tuple[float, ...] = ()


class Unknown(NamedTuple):
    """A value that the program does not tell, and why."""

    cause: str


class Value(NamedTuple):
    """The value of another key; a frame that is not set has this name in the controller."""

    key: str


class Setting(NamedTuple):
    """New values of the state; the key "NAME*" stands for each "NAME[...]"."""

    values: Mapping[str, Any]


class Jump(NamedTuple):
    """A word of control flow; `label` is the place that "goto" and "branch" go to."""

    word: str
    label: str = ""


class Call(NamedTuple):
    """A call of a routine of this file."""

    name: str


def called(name: str, is_sure: bool) -> tuple[Any, ...]:
    """Return the items of a call of a routine of this file, or of one that may not happen."""
    return (Call(name),) if is_sure else (Jump("if"), Call(name), Jump("endif"))


def headed(word: str, calls: Iterable[Any]) -> Iterator[Any]:
    """Yield a word of control flow and the calls in its condition, in the order of a run."""
    items, is_after = [*calls], word in ("loop", "case")
    yield from () if is_after else items
    yield Jump(word)
    yield from (*items, Jump("then")) if is_after and items else ()


State = dict[str, Any]
LAST = "last motion"
MISSING = Unknown("not set")


def call_text(where: str, name: str) -> str:
    """Return the cause of a call of a routine that is not in the file."""
    return f"{where} (--harmless-call {name} if it changes no frame)"


def value_of(state: State, key: str) -> Any:
    """Return the value of a key; a frame that is not set is in the controller."""
    family = key.partition("[")[0] + "*"
    return state.get(key, state.get(family, Frame(key)))


def lost_state(state: State, cause: str) -> State:
    """Return the state after a statement that is not read: nothing is known."""
    return {**dict.fromkeys(state, Unknown(cause)), LAST: None}


@dataclass(eq=False)
class Routine:
    """A routine: its items and its entry.

    Attributes:
        name: name; "" for statements outside routines.
        items: motions, settings, jumps and calls, in the order of the text.
        entry: "file": entered from other programs, too; "called": only by calls in the file;
            "interrupt": at any time.
    """

    name: str
    items: list[Any] = field(default_factory=list)
    entry: str = "called"


@dataclass(eq=False)
class _Block:
    items: list[Any] = field(default_factory=list)
    after: list[int] = field(default_factory=list)
    is_handler: bool = False


class _Graph:
    """Blocks of a routine without branches inside, and the ways between them."""

    def __init__(self, items: Iterable[Any]) -> None:
        self.blocks, self.now, self.ends = [_Block()], 0, list[int]()
        self.closes = True
        stack, labels, jumps = list[list[Any]](), dict[str, int](), list[tuple[int, str]]()
        for item in items:
            word = item.word if isinstance(item, Jump) else ""
            if not word:
                self.blocks[self.now].items.append(item)
            elif word in ("if", "switch"):
                stack.append([word, self.now, [], False])
                self._begin(*[self.now] * (word == "if"))
            elif word == "loop":
                self._begin(self.now)
                stack.append([word, self.now, [], False])
                self._begin(self.now)
            elif word in ("goto", "branch"):
                jumps.append((self.now, item.label))
                self._begin(*[self.now] * (word == "branch"))
            elif word == "label":
                self._begin(self.now)
                labels[item.label] = self.now
            elif word in ("return", "retry", "handler"):
                self.ends.append(self.now)
                self._begin()
                self.blocks[self.now].is_handler = word == "handler"
            elif word in ("break", "continue"):
                loop = next((frame for frame in reversed(stack) if frame[0] == "loop"), None)
                if loop is None:
                    self.ends.append(self.now)
                elif word == "break":
                    loop[2].append(self.now)
                else:
                    self.blocks[self.now].after.append(loop[1])
                self._begin()
            elif word == "then" and stack:
                if stack[-1][0] == "loop":
                    stack[-1][2].append(self.now)
                else:
                    stack[-1][1] = self.now
                self._begin(self.now)
            elif not stack or (stack[-1][0] == "loop") != (word == "endloop"):
                self.closes = False
                return
            elif word in ("case", "else"):
                stack[-1][2].append(self.now)
                stack[-1][3] |= word == "else"
                self._begin(stack[-1][1])
            elif word == "endloop":
                _, head, breaks, _ = stack.pop()
                self.blocks[self.now].after.append(head)
                self._begin(head, *breaks)
            else:
                _, head, ways, is_complete = stack.pop()
                self._begin(*ways, self.now, *[head] * (not is_complete))
        self.ends.append(self.now)
        for block, label in jumps:
            if label in labels:
                self.blocks[block].after.append(labels[label])
        self.closes = not stack
        self.handlers = [i for i, block in enumerate(self.blocks) if block.is_handler]

    def _begin(self, *before: int) -> None:
        """Begin a block after others; without one it is reached by a label only."""
        self.blocks.append(_Block())
        self.now = len(self.blocks) - 1
        for block in before:
            self.blocks[block].after.append(self.now)


def _unsure_values(routines: Mapping[str, Routine]) -> State:
    """Return the unknown values of what interrupts and handlers that go back set at any time."""
    queue, names, values = list[Any](), set[str](), State()
    for routine in routines.values():
        words = [item.word if isinstance(item, Jump) else "" for item in routine.items]
        if routine.entry == "interrupt":
            queue += routine.items
        elif "retry" in words and "handler" in words:
            queue += routine.items[words.index("handler") :]
    for item in queue:
        if isinstance(item, Call) and item.name not in names:
            names.add(item.name)
            queue += routines[item.name].items
        elif isinstance(item, Setting):
            for key in item.values.keys() - {LAST}:
                cause = Unknown(f"{key} is set in a routine that is entered at any time")
                value = item.values[key]
                values[key] = value if isinstance(value, Unknown) else cause
    return values


class Flow:
    """Follow routines from their entries; `at` has the state at each reached motion.

    A subclass may define what an item does (`apply`) and what two ways have in common (`common`).
    """

    def __init__(self, routines: Mapping[str, Routine], start: State) -> None:
        self.unsure = _unsure_values(routines)
        self.routines, self.start = routines, self.apply(Setting(self.unsure), start)
        self.at: dict[Any, State] = {}
        self._graphs = {name: _Graph(routine.items) for name, routine in routines.items()}
        self._results: dict[Any, State | None] = {}
        self._active = set[str]()
        called_names = {
            item.name
            for routine in routines.values()
            for item in routine.items
            if isinstance(item, Call)
        }
        lost = lost_state(start, "a routine that is entered at any time")
        for name, routine in routines.items():
            if routine.entry != "called" or name not in called_names:
                self._run(name, lost if routine.entry == "interrupt" else self.start)

    def apply(self, item: Any, state: State) -> State:
        """Return the state after a motion or a setting."""
        if not isinstance(item, Setting):
            self.at[item] = self._joined(self.at.get(item), state)
            return {**state, LAST: item}
        new = dict(state)
        for key, value in item.values.items():
            if isinstance(value, Value):
                value = value_of(state, value.key)
            if key.endswith("*"):
                new = {name: old for name, old in new.items() if not name.startswith(key[:-1])}
            new[key] = self.unsure.get(key, value)
        return new

    def common(self, key: str, first: Any, second: Any) -> Any:
        """Return what two different values of a key have in common."""
        if key == LAST:
            return None
        cause = next((value.cause for value in (first, second) if isinstance(value, Unknown)), "")
        return Unknown(
            cause
            if cause and cause != MISSING.cause
            else f"{key} is not the same on all ways to it"
        )

    def _joined(self, first: State | None, second: State) -> State:
        if first is None or first == second:
            return second
        names = {*first, *second}
        pairs = {name: (first.get(name, MISSING), second.get(name, MISSING)) for name in names}
        return {key: a if a == b else self.common(key, a, b) for key, (a, b) in pairs.items()}

    def _run(self, name: str, start: State) -> State | None:
        """Return the state at the end of a routine; None if it has no end."""
        call = (name, frozenset(start.items()))
        if call in self._results:
            return self._results[call]
        graph = self._graphs[name]
        if name in self._active or not graph.closes:
            what = "calls itself" if graph.closes else "has blocks that do not close"
            state = lost_state(self.start, f"{name or 'the program'} {what}")
            if not graph.closes:
                for item in self.routines[name].items:
                    if not isinstance(item, Setting | Jump | Call):
                        self.apply(item, state)
            return state
        self._active.add(name)
        before: dict[int, State] = {0: start}
        queue, end, reached = [0], None, None
        while queue:
            index = heappop(queue)
            block, state = graph.blocks[index], before[index]
            for item in block.items:
                if graph.handlers:
                    reached = self._joined(reached, state)
                if isinstance(item, Call):
                    result = self._run(item.name, {**state, LAST: None})
                    if result is None:
                        break
                    state = {**result, LAST: None}
                else:
                    state = self.apply(item, state)
            else:
                end = self._joined(end, state) if index in graph.ends else end
                reached = self._joined(reached, state)
                ways = [(following, state) for following in block.after]
                ways += [(handler, reached) for handler in graph.handlers]
                for following, after in ways:
                    joined = self._joined(before.get(following), after)
                    if joined != before.get(following):
                        before[following] = joined
                        if following not in queue:
                            heappush(queue, following)
        self._active.discard(name)
        self._results[call] = end
        return end
