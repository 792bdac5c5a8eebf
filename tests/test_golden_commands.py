import json

import pytest

from golden_commands import KEPT, printed

pytestmark = [
    pytest.mark.slow,
    pytest.mark.xdist_group("golden commands"),  # one process makes all the numbers
]


@pytest.fixture(scope="module")
def now(tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict[str, list[float]]]:
    return printed(tmp_path_factory.mktemp("golden"))


KNOWN = json.loads(KEPT.read_text())


@pytest.mark.parametrize("command", KNOWN)
def test_a_command_prints_the_numbers_that_it_printed_before(
    command: str, now: dict[str, dict[str, list[float]]]
) -> None:
    assert KNOWN[command].keys() == now[command].keys()
    for place, numbers in KNOWN[command].items():
        assert now[command][place] == pytest.approx(numbers, rel=1e-12, abs=1e-300), place
