"""`deep-ensemble`: several fine-tuned networks that differ in their random numbers.

Lakshminarayanan, Pritzel and Blundell, "Simple and scalable predictive uncertainty estimation
using deep ensembles", NeurIPS 2017: the members' mean is the prediction, their spread says where
they have learned little. Here the members are `ft-mlp`, each with its own pre-training.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Annotated, Any

import numpy as np
import torch
from annotated_types import Ge

from stiff_models.fitted_model import NormalModel, left_out_fifths
from stiff_models.networks.onnx_export import MeanOf
from stiff_models.transfer.ft_mlp import FtMlp
from stiff_protocols.contract.errors import ModelError
from stiff_protocols.contract.types import FloatArray, Robot, Samples

LEAST_SHARE = 0.1
"""Of the errors at poses that were left out: the least of them that is the members' in common."""


def common_error(pair: FloatArray, members: int) -> FloatArray:
    """Return the (3,) root mean square, m, of what `members` networks err in common.

    With networks that scatter about their expectation with variance v, the mean of two has the
    squared error b² + v / 2 and the mean of all b² + v / members, while the variance among all is
    (1 - 1 / members) v on average. The square of what is returned, and that variance, are together
    the squared error of the mean of all.

    Args:
        pair: (2, n, 3) m, errors of two networks at the same n poses, which they did not learn.
        members: number of networks in the ensemble.
    """
    squared = (pair.mean(axis=0) ** 2).mean(axis=0)
    scatter = pair.var(axis=0, ddof=1).mean(axis=0)
    left = squared - (1.5 - 2.0 / members) * scatter
    return np.asarray(np.sqrt(np.maximum(left, LEAST_SHARE**2 * squared)))


@dataclass(kw_only=True, eq=False, repr=False)
class DeepEnsemble(NormalModel, FtMlp):
    """Mean of `members` fine-tuned MLPs; every option of `ft-mlp` is every member's.

    The first member chooses for all: the teacher, and with training="cv" the number of epochs. What
    the members err in common is seen at poses that were left out: two of the pre-trained networks
    are fine-tuned without each fifth of the training poses, with a teacher identified without them
    (the springs of their source domain are those of all). See `common_error`.

    Attributes:
        members: number of networks; the first has the seeds of ft-mlp, the others their own.
    """

    members: Annotated[int, Ge(2)] = 5

    def _fit(self, train: Samples, robot: Robot, validation: Samples | None, seed: int) -> None:
        self.check_params()
        if len(np.unique(train.pose_id)) < 2:
            raise ModelError(
                "deep-ensemble needs samples of two poses or more for its intervals, all "
                f"{len(train)} are of one"
            )
        first = self._member(0).fit(train, robot=robot, validation=validation, seed=seed)
        self.best_params_ = first.best_params_
        chosen: dict[str, Any] = dict(first.best_params_)
        if self.training == "cv":
            chosen["training"] = "normal"
        self.members_ = [first]
        seeds = np.random.default_rng(seed).integers(2**31, size=self.members - 1).tolist()
        for number, own in enumerate(seeds, start=1):
            member = self._member(number).set_params(**chosen)
            self.members_ += [member.fit(train, robot=robot, validation=validation, seed=own)]
        errors = []
        for learned, left_out in left_out_fifths(train, seed):
            pair = [
                member.fine_tuned_anew(learned, validation, own)
                for member, own in zip(self.members_, [seed, seeds[0]], strict=False)
            ]
            found = np.stack([one.predict(left_out.q, left_out.wrench) for one in pair])
            errors.append(found - left_out.deflection)
        self.noise_ = common_error(np.concatenate(errors, axis=1), self.members)
        self.diagnostics_ = {"members": float(self.members)} | self.members_[0].diagnostics_

    def _mean_and_deviation(
        self, q: FloatArray, wrench: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return the members' mean, and their variance plus that of their common errors."""
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
        """(members, n, 3) m."""
        return np.stack([member.predict(q, wrench) for member in self.members_])
