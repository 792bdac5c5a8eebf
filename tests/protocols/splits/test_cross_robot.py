"""Check `cross-robot`: holdout's splits with the target's source and another robot's."""

from __future__ import annotations

from helpers.made_samples import unloaded
from stiff_protocols.splits.cross_robot import OWN_SOURCE, CrossRobot
from stiff_protocols.splits.random_splits import Holdout


def test_each_of_holdouts_divisions_stands_under_both_conditions():
    options = {"test_fraction": 0.3, "validation_fraction": 0.25}
    divisions = Holdout(**options).splits(unloaded(20, 2), n_splits=3, seed=5)
    splits = CrossRobot(source="ur5-twin", **options).splits(unloaded(20, 2), n_splits=3, seed=5)
    for condition in (OWN_SOURCE, "source ur5-twin"):
        condition_splits = [split for split in splits if split.condition == condition]
        assert [split.index for split in condition_splits] == [0, 1, 2]
        assert [split.sha256 for split in condition_splits] == [split.sha256 for split in divisions]
        assert {split.source for split in condition_splits} == {
            "" if condition == OWN_SOURCE else "ur5-twin"
        }
    assert len(splits) == 6
    assert list(CrossRobot().source_datasets()) == ["kr10-twin@specimen=9"]
    assert not Holdout().source_datasets()
