"""What makes results comparable, and what it is called: beside each other no two are alike."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from stiff_bench.grouped import grouped

SHORT = 8
"""So many characters of a hash tell data apart."""


@dataclass(frozen=True, order=True)
class ContestName:
    """What makes results comparable.

    Attributes:
        dataset, protocol, condition: as shown.
        seed: of the run's splits.
        data_sha256: hash of the data set's numbers.
        source_sha256: of the other robot's data that source domains come from; "" for none.
    """

    dataset: str
    protocol: str
    condition: str
    seed: int
    data_sha256: str
    source_sha256: str = ""

    @property
    def text(self) -> str:
        """Data set, protocol and condition for people."""
        return " | ".join(filter(None, (self.dataset, self.protocol, self.condition)))


def label_parts(names: Iterable[ContestName]) -> dict[ContestName, tuple[str, ...]]:
    """Return the parts of each name for people: data set, protocol, condition, and what differs.

    Contests with one text have other seeds or other data (one file name, say); the seed or the
    hash that tells them apart stands there then, and only then.
    """
    parts = {}
    for same_text in grouped(dict.fromkeys(names), lambda name: name.text).values():
        differing = [
            kind
            for kind in ("seed", "data_sha256", "source_sha256")
            if len({getattr(name, kind) for name in same_text}) > 1
        ]
        for name in same_text:
            apart = {
                "seed": f"seed {name.seed}",
                "data_sha256": f"data {name.data_sha256[:SHORT]}",
                "source_sha256": f"source data {name.source_sha256[:SHORT] or 'none'}",
            }
            words = (name.dataset, name.protocol, name.condition, *map(apart.get, differing))
            parts[name] = tuple(word for word in words if word)
    return parts


def labels(names: Iterable[ContestName]) -> dict[ContestName, str]:
    """Return each name in one text, as `ContestName.text` has it, with what tells it apart."""
    return {name: " | ".join(parts) for name, parts in label_parts(names).items()}
