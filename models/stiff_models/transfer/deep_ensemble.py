"""`deep-ensemble`: several fine-tuned networks that differ in their random numbers.

Lakshminarayanan, Pritzel and Blundell, "Simple and scalable predictive uncertainty estimation
using deep ensembles", NeurIPS 2017: the members' mean is the prediction; their spread is larger
far from the training samples. Here the members are `ft-mlp`, each with its own pre-training.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Annotated, Any

import numpy as np
import torch
from annotated_types import Ge

from stiff_models.fitted_model import NormalModel
from stiff_models.networks.onnx_export import MeanOf
from stiff_models.pose_folds import left_out_fifths
from stiff_models.transfer.ft_mlp import FtMlp
from stiff_protocols.contract.errors import ModelError
from stiff_protocols.contract.record import TEACHER_EPOCHS
from stiff_protocols.contract.types import FloatArray, Robot, Samples

LEAST_SHARE = 0.1
"""Least share of the errors at left-out poses that counts as the members' shared error."""


def common_error(pair: FloatArray, members: int) -> FloatArray:
    """Return the (3,) root mean square, m, of the shared error of `members` networks.

    Networks scatter about their expectation with variance v. Then the mean of two networks has the
    squared error b² + v / 2, and the mean of all has b² + v / members. The variance among all is
    (1 - 1 / members) v on average. The squared result plus that variance is the squared error of
    the mean of all.

    Args:
        pair: (2, n, 3) m, errors of two networks at the same n left-out poses.
        members: number of networks in the ensemble.
    """
    squared = (pair.mean(axis=0) ** 2).mean(axis=0)
    scatter = pair.var(axis=0, ddof=1).mean(axis=0)
    common_variance = squared - (1.5 - 2.0 / members) * scatter
    return np.asarray(np.sqrt(np.maximum(common_variance, LEAST_SHARE**2 * squared)))


@dataclass(kw_only=True, eq=False, repr=False)
class DeepEnsemble(NormalModel, FtMlp):
    """Mean of `members` fine-tuned MLPs; all members share the options of `ft-mlp`.

    The first member chooses the teacher for all and, with training="cv", the number of epochs. The
    members' shared error is estimated at left-out poses. For each fifth of the training poses, two
    of the pre-trained networks are fine-tuned without these poses, with a teacher identified
    without them. Their source domain keeps the springs of all poses. See `common_error`.

    Attributes:
        members: number of networks; the first has the seeds of ft-mlp, the others have their own.
    """

    members: Annotated[int, Ge(2)] = 5

    def _fit(self, train: Samples, robot: Robot, validation: Samples | None, seed: int) -> None:
        self.check_params()
        if len(np.unique(train.pose_id)) < 2:
            raise ModelError(
                f"all {len(train)} training samples have the same pose; deep-ensemble requires "
                "samples of two poses or more for its intervals"
            )
        first = self._member(0).fit(train, robot=robot, validation=validation, seed=seed)
        self.best_params_ = first.best_params_
        chosen: dict[str, Any] = dict(first.best_params_)
        if self.training == "cv":
            chosen["training"] = "normal"
        self.members_ = [first]
        seeds = np.random.default_rng(seed).integers(2**31, size=self.members - 1).tolist()
        for number, member_seed in enumerate(seeds, start=1):
            member = self._member(number).set_params(**chosen)
            self.members_ += [
                member.fit(train, robot=robot, validation=validation, seed=member_seed)
            ]
        errors = []
        for learned, left_out in left_out_fifths(train, seed):
            pair = [
                member.fine_tuned_on(learned, validation, member_seed)
                for member, member_seed in zip(self.members_, [seed, seeds[0]], strict=False)
            ]
            predictions = np.stack([member.predict(left_out.q, left_out.wrench) for member in pair])
            errors.append(predictions - left_out.deflection)
        self.noise_ = common_error(np.concatenate(errors, axis=1), self.members)
        self.diagnostics_ = {"members": float(self.members)} | self.members_[0].diagnostics_
        if self.is_anchored:
            epochs = (member.diagnostics_[TEACHER_EPOCHS] for member in self.members_)
            self.diagnostics_[TEACHER_EPOCHS] = sum(epochs)

    def _mean_and_deviation(
        self, q: FloatArray, wrench: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return the members' mean, and its deviation from their variance and shared errors."""
        members = self._of_members(q, wrench)
        return members.mean(axis=0), np.sqrt(members.var(axis=0) + self.noise_**2)

    def _member(self, number: int) -> FtMlp:
        """Return an unfitted network with the ensemble's options and source."""
        options = {item.name: getattr(self, item.name) for item in fields(FtMlp) if item.init}
        member = FtMlp(**options | {"pretrain_seed": self.pretrain_seed + number})
        member.use_source(self._source)
        return member

    def _predict(self, q: FloatArray, wrench: FloatArray) -> FloatArray:
        return np.asarray(self._of_members(q, wrench).mean(axis=0))

    def _torch_module(self) -> torch.nn.Module:
        return MeanOf(member._torch_module() for member in self.members_)

    def _of_members(self, q: FloatArray, wrench: FloatArray) -> FloatArray:
        """Return the members' predictions, (members, n, 3) m."""
        return np.stack([member.predict(q, wrench) for member in self.members_])
