"""Studies: runs that a file describes, and the pages that are written of them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from stiff_bench.api.evaluation import Run
from stiff_bench.api.registered import registry
from stiff_bench.api.stored_results import Results
from stiff_bench.console import say
from stiff_bench.paper.study_file import Study, find_study, read_study
from stiff_bench.run.machine import usable_cores
from stiff_bench.run.runner import chosen_execution
from stiff_bench.store.database import ResultStore, stored_statuses


@dataclass(frozen=True)
class Reproduction(Run):
    """A study, and the page that is written of it.

    Attributes:
        study: what is run, and what stands on the page.
        output: folder of the study's folder, which takes page and results.
    """

    study: Study
    output: Path

    def compute(self) -> Results:
        """Say how long it takes, and compute what is missing.

        Raises:
            StiffBenchError: the data cannot be loaded or divided, or the output not written.
        """
        ResultStore(self.plans[0].output)  # a folder that cannot be written is said before all else
        say(self.forecast().text)
        return super().compute()

    def write(self) -> Iterator[Path]:
        """Write what the results allow, and yield each file.

        Raises:
            StoreError: a file cannot be written, or a stored one is corrupt.
        """
        from stiff_bench.paper.study_page import write_page

        stored = stored_statuses(self.plans[0].output)
        n_missing = sum(task.cell.key not in stored for task in self.tasks)
        return write_page(self.study, self.output, self.plans[0].command, n_missing)


def run_of_study(file: Path, *, output: Path, command: str, **how: Any) -> Run:
    """Return the runs of a study's file; `how` is of `chosen_execution`.

    Raises:
        ConfigError: the file cannot be read, or a key or value of it is wrong.
    """
    plans = read_study(file).plans(registry(), output=output, command=command)
    return Run(plans, chosen_execution(plans[0], registry(), **how))


def reproduction(name: str, *, output: Path, command: str, **how: Any) -> Reproduction:
    """Return a study that is shipped, or that a file describes.

    Args:
        name: of the study, or of a file that ends in .toml.
        output: folder of the folder of the study's name.
        command: for the record.
        how: the options of `chosen_execution`; as many jobs as there are cores by default.

    Raises:
        ConfigError: there is no study of this name, or its file is wrong.
    """
    from stiff_bench.paper.study_page import check_names

    study = find_study(name)
    check_names(study)
    if how["jobs"] is None and not how["dask"] and how["isolate"] is not False:
        how["jobs"] = usable_cores()
    plans = study.plans(registry(), output=output / study.name / "runs", command=command)
    execution = chosen_execution(plans[0], registry(), **how)
    return Reproduction(plans, execution, study, output)
