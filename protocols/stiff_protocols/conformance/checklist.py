"""Questions, and answers that say what was found and how to mend it."""

from __future__ import annotations

import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from stiff_protocols.contract.errors import StiffBenchError

Status = Literal["passed", "failed", "not applicable"]
CheckFunction = Callable[[Any], str | None]
"""Of a subject; returns what there is to say, if anything. It raises NotApplicable, Failed, or
whatever the checked thing raises, which is a failure too."""


class NotApplicable(Exception):
    """The question cannot be asked of this model; says why."""


class Failed(Exception):
    """The answer is no; `advice` says how to mend it, "" where the question's own does."""

    def __init__(self, reason: str, advice: str = "") -> None:
        super().__init__(reason)
        self.advice = advice


class StageFailed(Exception):
    """A stage that several questions need ("fit", ...) failed with an error."""

    def __init__(self, stage: str, error: BaseException) -> None:
        super().__init__(f"{stage} failed")
        self.stage, self.error = stage, error


@dataclass(frozen=True)
class Check:
    """The answer to one question: what must hold, and "passed", "failed" or "not applicable".

    `reason` is what was found; `advice` how to mend a failed check; both may be "".
    """

    name: str
    status: Status
    reason: str = ""
    advice: str = ""

    def __str__(self) -> str:
        parts = [self.name, self.reason, self.advice and f"to mend it: {self.advice}"]
        return "; ".join(part for part in parts if part)


class Checklist:
    """Questions about one kind of subject, in the order in which they are written down."""

    def __init__(self) -> None:
        self._questions: list[tuple[str, str, CheckFunction]] = []

    def asks(self, name: str, advice: str) -> Callable[[CheckFunction], None]:
        """Return the decorator of a question: what must hold, and how to mend it."""
        return lambda question: self._questions.append((name, advice, question))

    def answers(self, subject: object) -> list[Check]:
        """Ask every question; never raises what a checked thing raises.

        The first question that meets a failed stage reports it; to the others it is not applicable.
        """
        reported: set[str] = set()
        checks = []
        for name, advice, question in self._questions:
            try:
                check = Check(name, "passed", question(subject) or "")
            except NotApplicable as answer:
                check = Check(name, "not applicable", str(answer))
            except StageFailed as failure:
                if failure.stage in reported:
                    check = Check(name, "not applicable", str(failure))
                else:
                    reported.add(failure.stage)
                    check = _failed(name, failure.error, advice)
            except (Exception, SystemExit) as error:
                check = _failed(name, error, advice)
            checks.append(check)
        return checks


def _failed(name: str, error: BaseException, advice: str) -> Check:
    """Our own errors speak for themselves, others need type and place."""
    if isinstance(error, Failed | StiffBenchError):
        return Check(name, "failed", str(error), getattr(error, "advice", "") or advice)
    place = traceback.extract_tb(error.__traceback__)[-1]
    where = f"{Path(place.filename).name}:{place.lineno}"
    return Check(name, "failed", f"raised {type(error).__name__}: {error} ({where})", advice)
