"""The protocols that stiffbench ships."""

from __future__ import annotations

from stiff_protocols.plugin import ProtocolInfo

PROTOCOLS = (
    ProtocolInfo(
        key="holdout",
        target="stiff_protocols.protocol:Holdout",
        summary="80/20 by pose; the best epoch is chosen on an inner part of the training side",
    ),
    ProtocolInfo(
        key="leave-one-out",
        target="stiff_protocols.protocol:LeaveOneOut",
        summary="each pose is tested once by a model that never saw it; metrics over all poses",
    ),
    ProtocolInfo(
        key="paper-holdout",
        target="stiff_protocols.protocol:PaperHoldout",
        summary="the source paper's: 80/20 at random, the 20 % also picks the best epoch",
        warning=(
            "paper-holdout picks the best epoch on the very samples it reports, as the source "
            "paper does: rows of models that choose an epoch are optimistic. Use 'holdout' for "
            "a fair comparison."
        ),
    ),
)
