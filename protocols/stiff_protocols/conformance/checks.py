"""Run checks, and say what was found and how to fix it.

A check is a function of its subject. Its name is what must hold, its docstring how to fix what does
not. It returns what there is to say, if anything; it raises NotApplicable, Failed, or whatever the
checked code raises, which is a failure too.
"""

from __future__ import annotations

import inspect
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from stiff_protocols.contract.errors import StiffBenchError

Status = Literal["passed", "failed", "not applicable"]
CheckFunction = Callable[[Any], str | None]


class NotApplicable(Exception):
    """The check does not apply; its message says why."""


class Failed(Exception):
    """The check failed; `advice` says how to fix it, "" for the docstring of the check."""

    def __init__(self, reason: str, advice: str = "") -> None:
        super().__init__(reason)
        self.advice = advice


class StageFailed(Exception):
    """A stage that several checks need ("fit", ...) failed with an error."""

    def __init__(self, stage: str, error: BaseException) -> None:
        super().__init__(f"{stage} failed")
        self.stage, self.error = stage, error


@dataclass(frozen=True)
class Check:
    """Result of one check.

    Attributes:
        name: what must hold.
        status: "passed", "failed" or "not applicable".
        reason: what was found; may be "".
        advice: how to fix a failed check; may be "".
    """

    name: str
    status: Status
    reason: str = ""
    advice: str = ""

    def __str__(self) -> str:
        parts = [self.name, self.reason, self.advice and f"to fix it: {self.advice}"]
        return "; ".join(part for part in parts if part)


def stage(name: str) -> Callable[[Callable[[Any], Any]], property]:
    """Make a method a property that is computed once, and whose failure is kept."""

    def kept(work: Callable[[Any], Any]) -> property:
        def value(subject: Any) -> Any:
            outcomes = vars(subject).setdefault("outcomes", {})
            if name not in outcomes:
                try:
                    outcomes[name] = work(subject)
                except StageFailed as failure:
                    outcomes[name] = failure
                except (Exception, SystemExit) as error:
                    outcomes[name] = StageFailed(name, error)
            if isinstance(outcomes[name], StageFailed):
                raise outcomes[name]
            return outcomes[name]

        return property(value)

    return kept


def run_checks(checks: Sequence[CheckFunction], subject: object) -> list[Check]:
    """Run checks in their order; what the checked code raises is a failure.

    The first check that meets a failed stage reports it; to the others it is not applicable.
    """
    reported: set[str] = set()
    results = []
    for check in checks:
        name = check.__name__.replace("_", " ")
        advice = " ".join((inspect.getdoc(check) or "").split()).removesuffix(".")
        try:
            result = Check(name, "passed", check(subject) or "")
        except NotApplicable as answer:
            result = Check(name, "not applicable", str(answer))
        except StageFailed as failure:
            if failure.stage in reported:
                result = Check(name, "not applicable", str(failure))
            else:
                reported.add(failure.stage)
                result = _failed(name, failure.error, advice)
        except (Exception, SystemExit) as error:
            result = _failed(name, error, advice)
        results.append(result)
    return results


def _failed(name: str, error: BaseException, advice: str) -> Check:
    """Our own errors speak for themselves, others need type and place."""
    if isinstance(error, Failed | StiffBenchError):
        return Check(name, "failed", str(error), getattr(error, "advice", "") or advice)
    place = traceback.extract_tb(error.__traceback__)[-1]
    where = f"{Path(place.filename).name}:{place.lineno}"
    return Check(name, "failed", f"raised {type(error).__name__}: {error} ({where})", advice)
