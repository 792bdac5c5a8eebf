import json
from pathlib import Path

import pytest

from golden_commands import KEPT, differences, printed

pytestmark = [
    pytest.mark.slow,
    pytest.mark.xdist_group("golden commands"),  # one process makes all the numbers
]


@pytest.fixture(scope="module")
def now(tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict[str, list[float]]]:
    return printed(tmp_path_factory.mktemp("golden"))


KNOWN = json.loads(Path(KEPT).read_text())


@pytest.mark.parametrize("command", KNOWN)
def test_a_command_prints_the_numbers_that_it_printed_before(
    command: str, now: dict[str, dict[str, list[float]]]
) -> None:
    assert differences(KNOWN[command], now[command]) == []
