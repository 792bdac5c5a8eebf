"""Find published results to compare with a new model."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from stiff_bench.paper.study_file import Study, shipped_folder
from stiff_bench.plan.fits import FitTask
from stiff_bench.results.notes import outdated_models
from stiff_bench.store.database import FILE, has_results, read_results, why_no_results
from stiff_bench.store.names import SHORT, grouped
from stiff_bench.tables.units import counted, first_few
from stiff_protocols.contract.errors import ConfigError
from stiff_protocols.contract.record import Fit, FitResult, Presentation

PUBLISHED = "published"
"""Value of `--against` for the results in the repository."""
OPTION = "against"

Place = tuple[str, str, str, int, int]
"""Data set, protocol, condition, seed and number of a split."""


def place_of(fit: Fit, presentation: Presentation) -> Place:
    """Return the split of the study that a fit belongs to."""
    return presentation.dataset, presentation.protocol, fit.condition, fit.seed, fit.split_index


def place_text(place: Place) -> str:
    """Return a text that names a split of the study."""
    dataset, protocol, condition, seed, index = place
    where = ", ".join(filter(None, [condition, f"seed {seed}", f"split {index}"]))
    return f"{dataset} under {protocol} ({where})"


def published_folder(word: str, study: Study) -> Path:
    """Return the folder of results that `--against` names.

    Raises:
        ConfigError: it holds no results, or stiffbench is installed without its repository.
    """
    if word != PUBLISHED:
        folder = Path(word)
        if not has_results(folder):
            raise ConfigError(f"{folder}: {why_no_results(folder)}", OPTION)
        return folder
    folder = shipped_folder().parent / study.name / "runs"
    if not has_results(folder):
        raise ConfigError(
            f"{PUBLISHED}: no {folder / FILE}; published results come with the repository, not "
            "with the installed package: give their folder, --against DIR",
            OPTION,
        )
    return folder


def find_published(folder: Path, tasks: Sequence[FitTask]) -> list[FitResult]:
    """Return published results of other models on the splits of some fits.

    Raises:
        ConfigError: a split has other data or other rows there, a model another version, or no
            split of these fits is there.
        StoreError: the folder cannot be read.
    """
    models = {task.presentation.model for task in tasks}
    fits = {place_of(task.fit, task.presentation): task.fit for task in tasks}
    stored = [result for result in read_results(folder) if result.status == "ok"]
    of_place = grouped(stored, lambda result: place_of(result.fit, result.presentation))
    shared = {place: of_place[place] for place in fits if place in of_place}
    if not shared:
        splits = first_few([place_text(place) for place in fits])
        raise ConfigError(f"{folder}: no results on the splits of this run: {splits}", OPTION)
    same_splits = [result for results in shared.values() for result in results]
    reasons = [*_differing_splits(fits, shared), *_other_versions(same_splits)]
    if reasons:
        advice = "use the stiffbench that computed them, or leave --against out"
        raise ConfigError(f"{folder}: {first_few(reasons)}; {advice}", OPTION)
    return [result for result in same_splits if result.presentation.model not in models]


def missing_places(published: Iterable[FitResult], tasks: Iterable[FitTask]) -> list[str]:
    """Return texts on the splits of some fits without a published result."""
    there = {place_of(result.fit, result.presentation) for result in published}
    places = dict.fromkeys(place_of(task.fit, task.presentation) for task in tasks)
    return [place_text(place) for place in places if place not in there]


def _differing_splits(
    fits: dict[Place, Fit], published: dict[Place, list[FitResult]]
) -> Iterator[str]:
    """Yield a reason per split with other data or rows in the published results."""
    kinds = {"data": "data_sha256", "rows": "split_sha256", "source data": "source_sha256"}
    for place, results in published.items():
        for kind, name in kinds.items():
            here = getattr(fits[place], name)
            differing = [
                result for result in results if getattr(result.fit, name) not in ("", here)
            ]
            if differing and here:
                there = getattr(differing[0].fit, name)
                n_models = counted(
                    len({result.presentation.model for result in differing}), "model"
                )
                yield (
                    f"{place_text(place)}: other {kind} ({there[:SHORT]} there, {here[:SHORT]} "
                    f"here; {n_models})"
                )
                break


def _other_versions(results: Sequence[FitResult]) -> Iterator[str]:
    """Yield a reason if models have changed since."""
    if outdated := outdated_models(results):
        yield f"computed by other versions of {', '.join(outdated)}"
