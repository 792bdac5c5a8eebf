"""What every distance between domains keeps, and what its authors' or others' code gives."""

from __future__ import annotations

import pytest
import torch
from domain_rows import SOURCE, SOURCE_OUTPUTS, TARGET, TARGET_OUTPUTS, waves

from stiff_models.transfer.alignment import coral, dare_gram, jmmd, mk_mmd, rsd


def joint(source, target):
    """JMMD of features whose first two columns serve as outputs."""
    return jmmd((source, source[:, :2]), (target, target[:, :2]))


CASES = [
    *((distance, SOURCE, TARGET) for distance in (mk_mmd, joint, coral)),
    *((distance, *waves(5, 12)) for distance in (rsd, dare_gram)),
]


@pytest.mark.parametrize(("distance", "source", "target"), CASES)
def test_identical_samples_have_no_distance_and_others_the_same_both_ways(distance, source, target):
    assert distance(source, source).item() == pytest.approx(0.0, abs=1e-6)
    assert distance(source, source.flip(0)).item() == pytest.approx(0.0, abs=1e-6)
    assert distance(source, target).item() > 0.01
    assert distance(source, target).item() == pytest.approx(distance(target, source).item())


@pytest.mark.parametrize(
    ("value", "published"),
    [
        # skada 0.6.0, skada.deep.losses._maximum_mean_discrepancy with five Gaussians; UDTL,
        # loss/DAN.py (commit 9a349e9)
        (mk_mmd(SOURCE, TARGET), 3.1061729937692517),
        # UDTL, loss/JAN.py (commit 9a349e9), JAN with fix_sigma_list=[None, None]
        (jmmd((SOURCE, SOURCE_OUTPUTS), (TARGET, TARGET_OUTPUTS)), 5.0915652118071755),
        # skada 0.6.0, skada.deep.losses.deepcoral_loss
        (coral(SOURCE, TARGET), 0.06320981503793319),
        # TLLIB, tllib/alignment/rsd.py (commit 9fcd99c), with trade_off=0.1
        (rsd(*waves(3, 8)), 2.71243444628567),
        # github.com/ismailnejjar/DARE-GRAM, code/dSprites/dare_gram.py (commit 5bbb90d),
        # DARE_GRAM_LOSS (threshold 0.9, trade-offs 0.05 and 0.001), in float64 on the CPU
        (dare_gram(*waves(7, 8)), 0.036728754748028815),
        (dare_gram(*waves(3, 5)), 0.04348716300863118),
        (dare_gram(*waves(8, 5)), 0.04468708658960039),
    ],
)
def test_values_are_those_of_public_implementations(value, published):
    assert value.item() == pytest.approx(published, rel=1e-9)


@pytest.mark.parametrize("distance", [mk_mmd, joint, coral])
def test_samples_of_different_length_are_compared(distance):
    assert torch.isfinite(distance(torch.cat([SOURCE, TARGET]), TARGET[:2]))


@pytest.mark.parametrize("distance", [mk_mmd, joint, coral])
@pytest.mark.parametrize("same", [True, False])
def test_gradients_are_finite_also_where_all_rows_are_the_same(distance, same):
    source = torch.ones(4, 6) if same else torch.randn(4, 6)
    source.requires_grad_()
    distance(source, torch.ones(3, 6)).backward()
    assert torch.isfinite(source.grad).all()
