"""Check that every shipped model keeps the contract on 43 real measurements."""

from __future__ import annotations

import pytest

from helpers.quick_models import KEYS
from stiff_models.io.cache_folder import OFF, VARIABLE
from stiff_models.io.model_file import load
from stiff_models.model_catalog import model_info
from stiff_protocols.conformance.model_checks import check_model

NOT_SAVABLE = (
    "realmlp",
    "tabm",
    "tabpfn",
    "tabicl",
)  # pickled by their packages, or another's weights


FOREST = "sklearn:ensemble.RandomForestRegressor"
LONG = (
    *("bayes-springs", "mlp", "dt-cnn", "ft-mlp", "compliance-net", "residual-mlp", "vjm-gp", "gp"),
    *("vjm-boosting", "deep-ensemble", FOREST, f"vjm+{FOREST}"),
)
"""Models whose checks take seconds."""


@pytest.mark.usefixtures("small_source")
@pytest.mark.parametrize(
    "key", [pytest.param(key, marks=[pytest.mark.slow] * (key in LONG)) for key in KEYS]
)
def test_a_shipped_model_keeps_the_contract(key, fanuc, monkeypatch):
    monkeypatch.setenv(VARIABLE, OFF)  # a remembered training always repeats itself
    info = model_info(key)
    if info.missing():
        pytest.skip(info.missing())
    cls = info.load()
    checks = check_model(
        lambda: cls(**info.quick), fanuc, uses_validation=info.uses_validation, load=load
    )
    failures = [str(check) for check in checks if check.status == "failed"]
    assert not failures, "\n".join(failures)
    checks_by_name = {check.name: check for check in checks}
    learning_check = checks_by_name["a fit learns from its own rows"]
    assert (learning_check.status == "passed") == (key != "zero"), learning_check
    saving_check = checks_by_name["save and load give the same numbers"]
    if key in NOT_SAVABLE:
        assert saving_check.status == "not applicable"
        pytest.skip(saving_check.reason)
    assert saving_check.status == "passed", (
        saving_check.reason
    )  # every other shipped model can be deployed
