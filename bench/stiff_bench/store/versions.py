"""Name the versions of stiffbench and libraries that made the results of a folder."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path

from stiff_bench.store.names import SHORT
from stiff_models.model_catalog import MODELS
from stiff_protocols.contract.record import CellResult, RunManifest

NO_MANIFEST = "a run without a manifest"
LIBRARIES = ("numpy", "scipy", "scikit-learn", "torch", "pin")
"""That the numbers go through."""


def sources(folder: Path, runs: Sequence[RunManifest], n_results: Mapping[str, int]) -> str:
    """Return a line that names the versions and commits that made results of a folder.

    `n_results` says of a run's id how many of its results are shown.
    """
    versions = {run.run_id: version_of_run(run) for run in runs}
    counts = Counter[str]()
    for run_id, count in n_results.items():
        counts[versions.get(run_id, NO_MANIFEST)] += count
    several = len(counts) > 1
    made = ", ".join(f"{name} ({n})" if several else name for name, n in sorted(counts.items()))
    return f"{counts.total()} results of {folder}, made by {made}."


def differing_libraries(
    runs: Sequence[RunManifest], run_ids: Mapping[str, Iterable[str]]
) -> Iterator[str]:
    """Yield a line for each library that models were computed with different versions of.

    `run_ids` says of a model which runs computed its results.
    """
    environments = {run.run_id: run.environment for run in runs}
    for library in LIBRARIES:
        used = {
            model: sorted({environments.get(run, {}).get(library, "unknown") for run in of_model})
            for model, of_model in run_ids.items()
        }
        if len({tuple(versions) for versions in used.values()}) > 1:
            models_text = "; ".join(
                f"{model}: {', '.join(versions)}" for model, versions in used.items()
            )
            yield f"Computed with different versions of {library}: {models_text}."


def version_of_run(run: RunManifest) -> str:
    """Return version and commit of stiffbench, for people."""
    facts = run.environment
    commit = facts.get("commit", "")[:SHORT]
    changed = " with uncommitted changes" if facts.get("dirty") == "true" else ""
    at = f" at {commit}{changed}" if commit else ""
    return f"stiffbench {facts.get('stiffbench', 'of an unknown version')}{at}"


def outdated_models(results: Iterable[CellResult]) -> list[str]:
    """Return the shipped models with results of an earlier version.

    Third-party models are omitted: their versions are not plain numbers.
    """
    today = {info.key: str(info.version) for info in MODELS}
    of_cells = {(result.cell.model, result.cell.model_version) for result in results}
    numbered = {(key, version) for key, version in of_cells if version.isdecimal()}
    return sorted({key for key, version in numbered if today.get(key, version) != version})
