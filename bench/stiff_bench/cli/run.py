"""What `bench run` and `bench reproduce` print of a run."""

from __future__ import annotations

from stiff_bench.api.results import Results
from stiff_bench.api.run import Run
from stiff_bench.console import print_text, say


def execute(run: Run, fmt: str, *, verbose: bool = False) -> int:
    """Compute a run, print its tables, and return the exit status: 1 if a cell failed or skipped.

    Raises:
        StiffBenchError: the data cannot be loaded or divided, or the output not written.
    """
    results = run.compute()
    print_text(results.table(verbose=verbose).text_as(fmt))
    say_summary(results)
    return 0 if all(result.status == "ok" for result in results.cells) else 1


def say_summary(results: Results) -> None:
    """Say what became of the cells, where results are, and how old failures are computed again."""
    finished = results.finished
    assert finished is not None
    say(f"{finished.summary}; {finished.wall_s:.1f} s; stored in {results.folder}")
    failed = [one.cell.key for one in finished.results if one.status == "failed"]
    if old := len(finished.cached.intersection(failed)):
        say(f"{old} of the failures are of earlier runs; --rerun failed computes them again")


def show_plan(run: Run, fmt: str) -> int:
    """Print what a run would compute, and compute nothing.

    Raises:
        StiffBenchError: the data cannot be loaded or divided.
    """
    found = run.forecast()
    print_text(found.text_as(fmt))
    say(found.text)
    return 0
