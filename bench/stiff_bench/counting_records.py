"""Which of several records of one cell counts.

A result, whatever failed before it or after: a cell has one key for all that shapes its numbers, so
that computing it again gives the same ones, and a rerun that timed out takes nothing away. Of
several results, and of several failures where there is no result, the newest.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Set

from stiff_protocols.record import CellResult


class CountingRecords:
    """Takes records, the newest first, and keeps one of each cell.

    Args:
        keys: of the cells that are wanted; None: all.
    """

    def __init__(self, keys: Set[str] | None) -> None:
        """Store the keys."""
        self._wanted = keys
        self._done: set[str] = set()
        self._failures: dict[str, CellResult] = {}

    def may_count(self, key: str, *, ok: bool) -> bool:
        """Say whether a record is worth reading."""
        wanted = self._wanted is None or key in self._wanted
        return wanted and key not in self._done and (ok or key not in self._failures)

    def results(self, records: Iterable[CellResult]) -> Iterator[CellResult]:
        """Yield the results that count; failures wait, since an older result may come."""
        for one in records:
            key, ok = one.cell.key, one.status == "ok"
            if self.may_count(key, ok=ok):
                if ok:
                    self._done.add(key)
                    yield one
                else:
                    self._failures[key] = one

    def failures(self) -> Iterator[CellResult]:
        """Yield the failures of cells without a result, after all records were taken."""
        return (one for key, one in self._failures.items() if key not in self._done)
