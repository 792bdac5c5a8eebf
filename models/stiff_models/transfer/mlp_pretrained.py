"""`mlp-pretrained`: the base network trained on the simulated source domain alone.

It sees the measurements only through the VJM that is identified on the training part and
supplies the source domain's deflections; with another robot's source it does not see them at all.
"""

from __future__ import annotations

from dataclasses import dataclass

from stiff_models.transfer.anchor import Anchor, AnchoredMlp
from stiff_models.transfer.source_model import NO_TARGET_LABELS
from stiff_protocols.contract.types import Robot, Samples


@dataclass(kw_only=True, eq=False, repr=False)
class MlpPretrained(AnchoredMlp):
    """Pre-training on the source domain.

    With an anchor it predicts what its teacher predicts: nothing is fine-tuned.
    """

    anchor: Anchor = "none"

    @property
    def regime(self) -> str:
        """No measured deflection trains the network."""
        return NO_TARGET_LABELS if self.is_anchored else self._unlabelled()

    def _fit(self, train: Samples, robot: Robot, validation: Samples | None, seed: int) -> None:
        super()._fit(train, robot, validation, seed)
        if self.is_anchored:
            self.source_network_ = self.network_
