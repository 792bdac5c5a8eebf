"""Run checks, and report findings and how to fix them.

The checks of a subject are the public methods of its class, in their order. A method's name states
the requirement; its docstring states the fix. A method returns a finding to report, or nothing. It
raises NotApplicable or Failed. Any error of the checked code is also a failure.
"""

from __future__ import annotations

import inspect
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypeVar

from stiff_protocols.contract.errors import StiffBenchError

Status = Literal["passed", "failed", "not applicable"]
Result = TypeVar("Result")


class NotApplicable(Exception):
    """The check does not apply; the message is the reason."""


class Failed(Exception):
    """The check failed; `advice` is the fix, "" for the docstring of the check."""

    def __init__(self, reason: str, advice: str = "") -> None:
        super().__init__(reason)
        self.advice = advice


@dataclass(frozen=True)
class Check:
    """Result of one check.

    Attributes:
        name: requirement.
        status: "passed", "failed" or "not applicable".
        reason: finding; may be "".
        advice: fix of a failed check; may be "".
    """

    name: str
    status: Status
    reason: str = ""
    advice: str = ""

    def __str__(self) -> str:
        parts = [self.name, self.reason, self.advice and f"to fix it: {self.advice}"]
        return "; ".join(part for part in parts if part)


def remembered(work: Callable[..., Result]) -> Callable[..., Result]:
    """Compute a method once per set of arguments; its error is raised again.

    Give all arguments, or none.
    """
    defaults = getattr(work, "__defaults__", None) or ()

    def outcome(subject: Any, *arguments: str) -> Result:
        outcomes = vars(subject).setdefault("outcomes", {})
        arguments = arguments or defaults
        key = (work.__name__, *arguments)
        if key not in outcomes:
            try:
                outcomes[key] = work(subject, *arguments), None
            except (Exception, SystemExit) as error:
                outcomes[key] = None, error
        result: Result
        result, problem = outcomes[key]
        if problem is not None:
            raise problem
        return result

    return outcome


def run_checks(subject: object) -> list[Check]:
    """Run the checks of a subject; any error of the checked code is a failure.

    The first check reports an error that occurs in several checks; the others are not applicable.
    """
    results = []
    first_check: dict[int, tuple[BaseException, str]] = {}  # by id, of errors that are kept alive
    for method, check in vars(type(subject)).items():
        if method.startswith("_") or not inspect.isfunction(check):
            continue
        name = method.replace("_", " ")
        try:
            result = Check(name, "passed", check(subject) or "")
        except NotApplicable as answer:
            result = Check(name, "not applicable", str(answer))
        except (Exception, SystemExit) as error:
            _, first = first_check.setdefault(id(error), (error, name))
            if first == name:
                advice = " ".join((inspect.getdoc(check) or "").split()).removesuffix(".")
                result = _failed(name, error, advice)
            else:
                result = Check(name, "not applicable", f"see {first!r}")
        results.append(result)
    return results


def _failed(name: str, error: BaseException, advice: str) -> Check:
    """Return a failed check; errors of other libraries get type and place."""
    if isinstance(error, Failed | StiffBenchError):
        return Check(name, "failed", str(error), getattr(error, "advice", "") or advice)
    place = traceback.extract_tb(error.__traceback__)[-1]
    where = f"{Path(place.filename).name}:{place.lineno}"
    return Check(name, "failed", f"raised {type(error).__name__}: {error} ({where})", advice)
