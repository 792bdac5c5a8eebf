"""Questions, and answers that say what was found and how to mend it."""

from __future__ import annotations

import traceback
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, Literal, TypeVar

from stiff_protocols.contract.errors import StiffBenchError

Status = Literal["passed", "failed", "not applicable"]
Subject = TypeVar("Subject")


class NotApplicable(Exception):
    """The question cannot be asked of this model; says why."""


class Failed(Exception):
    """The answer is no.

    Attributes:
        advice: how to mend it; "" where the question's own advice does.
    """

    def __init__(self, reason: str, advice: str = "") -> None:
        """Store both."""
        super().__init__(reason)
        self.advice = advice


class StageFailed(Exception):
    """A stage that several questions need failed.

    Attributes:
        stage: "fit", ...
        error: what was raised.
    """

    def __init__(self, stage: str, error: BaseException) -> None:
        """Store both."""
        super().__init__(f"{stage} failed")
        self.stage, self.error = stage, error


def said(error: BaseException) -> str:
    """Return an error for people: our own speak for themselves, others need type and place."""
    if isinstance(error, Failed | StiffBenchError):
        return str(error)
    place = traceback.extract_tb(error.__traceback__)[-1]
    return f"raised {type(error).__name__}: {error} ({Path(place.filename).name}:{place.lineno})"


@dataclass(frozen=True)
class Check:
    """The answer to one question.

    Attributes:
        name: what must hold.
        status: "passed", "failed" or "not applicable".
        reason: what was found; "" where there is nothing to say.
        advice: how to mend a failed check; "" for the others.
    """

    name: str
    status: Status
    reason: str = ""
    advice: str = ""

    def __str__(self) -> str:
        """Return one line."""
        parts = [self.name, self.reason, self.advice and f"to mend it: {self.advice}"]
        return "; ".join(part for part in parts if part)


@dataclass(frozen=True)
class Question(Generic[Subject]):
    """One thing to find out.

    Attributes:
        name: what must hold.
        ask: returns what there is to say, or raises: NotApplicable, Failed, or whatever the
            checked thing raises, which is a failure too.
        advice: how to mend it.
    """

    name: str
    ask: Callable[[Subject], str]
    advice: str

    def answer(self, subject: Subject, known: set[str]) -> Check:
        """Ask; never raises what a checked thing raises.

        Args:
            subject: what is asked about.
            known: stages that another question reported as failed; this one adds its own.
        """
        try:
            return Check(self.name, "passed", self.ask(subject))
        except NotApplicable as answer:
            return Check(self.name, "not applicable", str(answer))
        except StageFailed as failure:
            if failure.stage in known:
                return Check(self.name, "not applicable", str(failure))
            known.add(failure.stage)
            return self._failed(failure.error)
        except (Exception, SystemExit) as error:
            return self._failed(error)

    def _failed(self, error: BaseException) -> Check:
        advice = error.advice if isinstance(error, Failed) and error.advice else self.advice
        return Check(self.name, "failed", said(error), advice)


def answers(questions: Iterable[Question[Subject]], subject: Subject) -> list[Check]:
    """Ask every question, in this order.

    The first one that meets a failed stage reports it; to the others it is not applicable.
    """
    known: set[str] = set()
    return [question.answer(subject, known) for question in questions]
