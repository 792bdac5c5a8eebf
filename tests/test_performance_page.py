"""The page that `make perf` writes, from a made run of the benchmarks."""

from __future__ import annotations

import runpy
from pathlib import Path

SCRIPT = Path(__file__).parent / "perf" / "write_page.py"
ROWS = """
| stiffbench | 2 us a sum ± 5% | loop | 5 us a sum | 2.5 | ≥ 2: met |
| stiffbench | 2 us a sum ± 5% | tree | 4 ms a sum ± 5% | 2e+03 | |
| read | 3 s a GB ± 5% |
| read: error | 0.5 mm | ≤ 0.4: missed |
"""  # a ratio compares times of the same work, not times of calls


def entry(group, who, median, rounds=5, **about):
    about = {"who": who, "ours": False, "work": 1.0, "unit": "sum"} | about
    stats = {"median": median, "iqr": median / 10, "rounds": rounds}
    return {"group": group, "stats": stats, "extra_info": about}


def test_the_page_says_what_was_measured_where_and_whether_its_target_is_met():
    error = {"what": "error", "value": 0.5, "unit": "mm", "at_most": 0.4}
    report = {
        "datetime": "2026-11-22T10:00:00+00:00",
        "machine_info": {"cpu": {"brand_raw": "Some CPU", "count": 2}, "python_version": "3.11.7"},
        "commit_info": {"id": "abc123", "dirty": True},
        "benchmarks": [
            entry("adding", "stiffbench", 4e-6, ours=True, work=2.0, at_least={"loop": 2.0}),
            entry("adding", "loop", 5e-6, rounds=1),
            entry("adding", "tree", 4e-3),
            entry("machine", "read", 3.0, unit="GB", figures=[error]),
        ],
    }
    page = runpy.run_path(str(SCRIPT))["page"](report)
    lines = {" ".join(line.split()) for line in page.splitlines()}
    assert set(ROWS.strip().splitlines()) <= lines
    assert all(word in page for word in ("2026-11-22", "Some CPU", "abc123 with changes"))
