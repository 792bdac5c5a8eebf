"""Protocols that divide the poses at random: every test pose is like the training poses."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

from annotated_types import Ge, Gt, Lt

from stiff_protocols.contract.errors import ConfigError
from stiff_protocols.contract.types import Samples, Split
from stiff_protocols.splits import generators as splits

Fraction = Annotated[float, Gt(0.0), Lt(1.0)]


class Holdout:
    """Random 80/20 division by pose; a fifth of the training side chooses the epoch.

    Attributes:
        test_fraction: of all poses.
        validation_fraction: of the training side's poses, chooses the epoch.
    """

    selects_on_test = False
    pooled = False

    def __init__(
        self, *, test_fraction: Fraction = 0.2, validation_fraction: Fraction = 0.2
    ) -> None:
        """Store the options."""
        self.test_fraction = test_fraction
        self.validation_fraction = validation_fraction

    def splits(self, samples: Samples, *, n_splits: int | None, seed: int) -> Sequence[Split]:
        """Return `n_splits` (default 1) divisions."""
        return splits.holdout_by_pose(
            samples,
            n_splits=n_splits or 1,
            test_fraction=self.test_fraction,
            validation_fraction=self.validation_fraction,
            seed=seed,
        )


class RepeatedHoldout(Holdout):
    """`holdout` drawn many times, enough for a corrected t test.

    Attributes:
        repetitions: how many divisions; --splits has the last word.
    """

    def __init__(
        self,
        *,
        repetitions: Annotated[int, Ge(2)] = 15,
        test_fraction: Fraction = 0.2,
        validation_fraction: Fraction = 0.2,
    ) -> None:
        """Store the options."""
        super().__init__(test_fraction=test_fraction, validation_fraction=validation_fraction)
        self.repetitions = repetitions

    def splits(self, samples: Samples, *, n_splits: int | None, seed: int) -> Sequence[Split]:
        """Return the divisions; the first ones are `holdout`'s of the same seed."""
        return super().splits(samples, n_splits=n_splits or self.repetitions, seed=seed)


class KFold:
    """Poses in k parts of about one size; each part is tested by models of the others.

    Attributes:
        folds: how many parts; other folds are another protocol, so --splits cannot change them.
        validation_fraction: of the training side's poses, chooses the epoch.
    """

    selects_on_test = False
    pooled = False

    def __init__(
        self, *, folds: Annotated[int, Ge(2)] = 5, validation_fraction: Fraction = 0.2
    ) -> None:
        """Store the options."""
        self.folds = folds
        self.validation_fraction = validation_fraction

    def splits(self, samples: Samples, *, n_splits: int | None, seed: int) -> Sequence[Split]:
        """Return one division a part.

        Raises:
            ConfigError: another number of splits was asked for, or there are too few poses.
        """
        if n_splits not in (None, self.folds):
            raise ConfigError(
                f"--splits {n_splits}: kfold has {self.folds} splits, one a fold; leave --splits "
                f"out, or use --protocol kfold@folds={n_splits}"
            )
        return splits.folds_by_pose(
            samples,
            n_folds=self.folds,
            validation_fraction=self.validation_fraction,
            seed=seed,
        )


class PaperHoldout:
    """The source paper's division: 80/20 by pose, and the 20 % also picks the best epoch.

    Attributes:
        test_fraction: of all poses.
    """

    selects_on_test = True
    pooled = False

    def __init__(self, *, test_fraction: Fraction = 0.2) -> None:
        """Store the options."""
        self.test_fraction = test_fraction

    def splits(self, samples: Samples, *, n_splits: int | None, seed: int) -> Sequence[Split]:
        """Return `n_splits` (default 1) divisions."""
        return splits.holdout_that_selects(
            samples, n_splits=n_splits or 1, test_fraction=self.test_fraction, seed=seed
        )


class LeaveOneOut:
    """Each pose is tested once; the metrics are computed over the predictions of all poses.

    Attributes:
        validation_fraction: of the training side's poses, chooses the epoch.
    """

    selects_on_test = False
    pooled = True

    def __init__(self, *, validation_fraction: Fraction = 0.2) -> None:
        """Store the options."""
        self.validation_fraction = validation_fraction

    def splits(self, samples: Samples, *, n_splits: int | None, seed: int) -> Sequence[Split]:
        """Return one division a pose.

        Raises:
            ConfigError: a number of splits was asked for; the poses give it.
        """
        if n_splits is not None:
            raise ConfigError(
                f"--splits {n_splits}: leave-one-out has one split a pose; leave --splits out"
            )
        return splits.leave_one_pose_out(
            samples, validation_fraction=self.validation_fraction, seed=seed
        )
