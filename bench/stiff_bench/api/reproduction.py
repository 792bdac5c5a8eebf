"""The committed studies made again: the source paper's tables and figures, and others."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from stiff_bench.api.catalog import registry
from stiff_bench.api.evaluation import Run
from stiff_bench.api.results import Results
from stiff_bench.console import say
from stiff_bench.paper import study
from stiff_bench.paper.effects import write_effects, write_transfer
from stiff_bench.paper.pages import write_leaderboard, write_paper
from stiff_bench.run.machine import usable_cores
from stiff_bench.run.runner import chosen_execution
from stiff_bench.store.database import ResultStore, stored_statuses
from stiff_models.model_catalog import MODELS

What = Literal["paper", "leaderboard", "effects", "transfer"]
WRITERS = {
    "paper": write_paper,
    "leaderboard": write_leaderboard,
    "effects": write_effects,
    "transfer": write_transfer,
}

STUDIES = {
    "leaderboard": lambda: study.leaderboard_study([info.key for info in MODELS]),
    "effects": study.effects_study,
    "transfer": study.transfer_study,
}


@dataclass(frozen=True)
class Reproduction(Run):
    """A study, and the pages that are written of it.

    Attributes:
        what: the pages.
        output: folder of pages and results.
    """

    what: What = "paper"
    output: Path = Path("results")

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
        stored = stored_statuses(self.plans[0].output)
        missing = sum(task.cell.key not in stored for task in self.tasks)
        return WRITERS[self.what](self.output, self.plans[0].command, missing)


def reproduction(
    what: What, *, full: bool, output: Path, command: str, paper_recipe: bool = False, **how: Any
) -> Reproduction:
    """Return the study behind the pages of a kind.

    Args:
        what: the pages.
        full: of the paper: five splits, every width, depth and pair of layers.
        output: folder of the folder of this name.
        command: for the record.
        paper_recipe: of the paper: the first split by its own recipe, too.
        how: the options of `chosen_execution`; as many jobs as there are cores by default.

    Raises:
        ConfigError: two options contradict each other.
    """
    if what == "paper":
        runs = study.paper_study(full=full) + (study.paper_recipe_study() if paper_recipe else ())
    else:
        runs = STUDIES[what]()
    if how["jobs"] is None and not how["dask"] and how["isolate"] is not False:
        how["jobs"] = usable_cores()
    folder = output / what / "runs"
    plans = study.study_plans(runs, output=folder, command=command, registry=registry())
    execution = chosen_execution(plans[0], registry(), **how)
    return Reproduction(plans, execution, what, output)
