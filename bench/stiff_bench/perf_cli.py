"""`bench perf`."""

from __future__ import annotations

from pathlib import Path

import click

from stiff_bench.cli_options import FILE, command_line, debug_option, output_option
from stiff_bench.messages import print_text, say

PAGE, HISTORY = "performance.md", "performance_history.csv"


@click.command()
@click.option(
    "--only",
    default="",
    metavar="EXPRESSION",
    help=f"Benchmarks whose name matches, as pytest's -k; {PAGE} is then left as it is.  "
    "[default: all]",
)
@click.option("--long", is_flag=True, help="The studies of several minutes, too.")
@click.option(
    "--json", "json_file", type=FILE, metavar="FILE", help="Keep pytest-benchmark's own JSON."
)
@output_option(
    f"Where {PAGE}, its pictures and {HISTORY} are written; the history grows by one run."
)
@debug_option
def perf(only: str, long: bool, json_file: Path | None, output: Path) -> int:
    """Measure the hot paths beside their peers and print the ratios.

    Needs a checkout and the extra `perf`. Exit status 1: a benchmark failed.
    """
    from stiff_bench.perf_history import read_history, write_history
    from stiff_bench.perf_pictures import save_pictures
    from stiff_bench.perf_run import check_usable, run_benchmarks
    from stiff_bench.perf_tables import perf_page
    from stiff_bench.provenance import environment
    from stiff_protocols.files import make_folder, written_whole

    check_usable(json_file)  # before anything is written
    make_folder(output)
    history = read_history(output / HISTORY)
    report = run_benchmarks(only, long=long, json_file=json_file)
    facts = environment()
    page = perf_page(
        report,
        history,
        environment=facts,
        pictures=[] if only else save_pictures(report.curves, output),
        command=command_line(),
    )
    if not only:
        with written_whole(output / PAGE) as temporary:
            temporary.write_text(page + "\n", encoding="utf-8")
    measured = (*(timing.finding for timing in report.timings), *report.findings)
    write_history(output / HISTORY, history, measured, date=report.date, environment=facts)
    print_text(page)
    say(f"{len(report.timings)} benchmarks, {len(report.failed)} failed; stored in {output}")
    return 1 if report.failed else 0
