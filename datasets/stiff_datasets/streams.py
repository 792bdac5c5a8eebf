"""Random numbers that belong to a name."""

from __future__ import annotations

from hashlib import sha256

import numpy as np


def stream(*words: str | int) -> np.random.Generator:
    """Return the random numbers of the words: the same on every machine, others independent.

    Two data sets that share a seed must not share loads, noise or specimens by accident, or a
    comparison over data sets would count one draw twice. No word may hold a slash.
    """
    digest = sha256("/".join(map(str, words)).encode()).digest()
    return np.random.default_rng(int.from_bytes(digest, "little"))
