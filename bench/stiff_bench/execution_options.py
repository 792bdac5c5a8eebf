"""The options of `bench run` that say how cells are computed; only click is imported here."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from stiff_bench.cli_options import FiniteRange

if TYPE_CHECKING:
    from stiff_bench.config import RunPlan
    from stiff_bench.execution import Execution
    from stiff_bench.registry import Registry

_OPTIONS = (
    click.option(
        "--isolate/--no-isolate",
        default=None,
        help="Compute every cell in a process of its own, so that it can end no other.  [default: "
        "with several jobs, a limit, a cluster or a plugin's model]",
    ),
    click.option(
        "--timeout",
        type=FiniteRange(0, 1e7, min_open=True),
        metavar="SECONDS",
        help="Wall time that a cell may take.  [default: any]",
    ),
    click.option(
        "--memory",
        metavar="SIZE",
        help="Memory that a cell's process may take, such as 2GiB or 500MB.  [default: any]",
    ),
    click.option(
        "--threads",
        type=click.IntRange(1, 1024),
        help="Threads of the linear algebra in a cell, whatever the number of jobs.  [default: "
        "OMP_NUM_THREADS, or 1]",
    ),
    click.option(
        "--dask",
        default="",
        metavar="CLUSTER",
        help="Compute on a Dask cluster: tcp://HOST:PORT of its scheduler, or local:N workers.",
    ),
    click.option(
        "--plan",
        is_flag=True,
        help="Compute nothing; print how many cells there are, how many of them are in --output, "
        "and the time that the others will take by the stored fits of the same models.",
    ),
    click.option(
        "--rerun",
        type=click.Choice(["missing", "failed", "all"]),
        default="missing",
        show_default=True,
        help="Which cells are computed: those without a result or failure in --output, those that "
        "failed too, or all.",
    ),
)


def execution_options(command: Any, *, usual_jobs: str = "") -> Any:
    """Add the options.

    Args:
        command: that gets them.
        usual_jobs: what the help says of how many cells run at once by default; "": one.
    """
    jobs = click.option(
        "--jobs",
        type=click.IntRange(1, 1024),
        default=1,
        show_default=usual_jobs or True,
        help="How many cells run at once, each in a process of its own.",
    )
    for option in reversed((jobs, *_OPTIONS)):
        command = option(command)
    return command


def begin_execution(words: dict[str, Any]) -> dict[str, Any]:
    """Take the options out of a command's words; the number of threads holds from here on.

    To be called before anything heavy is imported, since libraries read it when they are loaded.
    """
    from stiff_bench.threads import pin_threads, threads_asked_for

    names = ("jobs", "isolate", "timeout", "memory", "threads", "dask", "rerun", "plan")
    taken = {name: words.pop(name) for name in names}
    taken["threads"] = taken["threads"] or threads_asked_for()
    pin_threads(taken["threads"])
    return taken


def execution_of(taken: dict[str, Any], plan: RunPlan, registry: Registry) -> Execution:
    """Return what the options mean for a plan.

    Raises:
        ConfigError: one is wrong, or two contradict each other.
    """
    from stiff_bench.execution import chosen_execution
    from stiff_bench.isolate import Limits

    limits = Limits(taken["threads"], taken["timeout"], _bytes(taken["memory"]))
    others = {name: taken[name] for name in ("jobs", "isolate", "dask", "rerun")}
    return chosen_execution(plan, registry, limits=limits, **others)


def _bytes(size: str | None) -> int | None:
    """Return a size in bytes.

    Raises:
        ConfigError: it is none.
    """
    from pydantic import ByteSize, TypeAdapter, ValidationError

    from stiff_protocols.errors import ConfigError

    if size is None:
        return None
    try:
        found = int(TypeAdapter(ByteSize).validate_python(size))
    except ValidationError:
        found = 0
    if found <= 0:
        raise ConfigError(f"--memory {size!r}: no size (valid: 2GiB, 500MB, ...)")
    return found
