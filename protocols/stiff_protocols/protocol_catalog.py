"""The protocols that stiffbench ships."""

from __future__ import annotations

from stiff_protocols.contract.plugin import ProtocolInfo

PROTOCOLS = (
    ProtocolInfo(
        key="holdout",
        target="stiff_protocols.splits.random_splits:Holdout",
        summary="80/20 by pose; validation poses of the training part may choose the epoch",
        reasoning=(
            "How well does a model do at new poses among the ones that were measured? One split "
            "says little: use --splits, or repeated-holdout."
        ),
    ),
    ProtocolInfo(
        key="repeated-holdout",
        target="stiff_protocols.splits.random_splits:RepeatedHoldout",
        summary="holdout repeated 15 times, for comparisons",
        reasoning=(
            "The same with its spread. The splits share samples: compare models with the "
            "corrected t test of `bench compare`, never with a plain one."
        ),
    ),
    ProtocolInfo(
        key="kfold",
        target="stiff_protocols.splits.random_splits:KFold",
        summary="5-fold cross-validation by pose",
        reasoning=(
            "Every pose is tested once, which uses few poses best; the training parts overlap, so"
            " the folds' results depend on each other."
        ),
    ),
    ProtocolInfo(
        key="leave-one-out",
        target="stiff_protocols.splits.random_splits:LeaveOneOut",
        summary="each pose is tested once, trained on all others; metrics over all poses",
        reasoning=(
            "For very small data sets: the training part is as large as it can be. Metrics are "
            "over all predictions together, as one pose gives no mean error worth the name."
        ),
    ),
    ProtocolInfo(
        key="sample-efficiency",
        target="stiff_protocols.splits.sample_efficiency:SampleEfficiency",
        summary="learning curve over 5, 10, 20, 40, 80, 121 measured poses, nested subsets",
        reasoning=(
            "A measured pose costs minutes at the robot: how many does a model need? Every size "
            "is tested on the same poses and holds the smaller ones; validation poses count."
        ),
    ),
    ProtocolInfo(
        key="space-transfer",
        target="stiff_protocols.splits.extrapolation:SpaceTransfer",
        summary="train on the joint-space poses, test on the Cartesian ones, and back",
        reasoning=(
            "A measurement plan covers one part of the robot's poses, and the work is done in "
            "another: does a model hold where it was not measured?"
        ),
    ),
    ProtocolInfo(
        key="load-extrapolation",
        target="stiff_protocols.splits.extrapolation:LoadExtrapolation",
        summary="train on light loads or some directions, test on heavy loads or other directions",
        reasoning=(
            "Weights on a cable are lighter than cutting forces and pull in few directions: does "
            "what was learned from them carry over?"
        ),
    ),
    ProtocolInfo(
        key="workspace-extrapolation",
        target="stiff_protocols.splits.workspace:WorkspaceExtrapolation",
        summary="hold out one of 4 regions of the workspace, train on the others",
        reasoning=(
            "Does a model hold where the TCP never was in training? Random splits cannot say: "
            "every test pose has neighbours that were measured."
        ),
    ),
    ProtocolInfo(
        key="sensor-noise",
        target="stiff_protocols.splits.sensor_noise:SensorNoise",
        summary="holdout with sensor noise and bias on test wrenches, 0 to 20 x an ATI Axia80-M8's",
        reasoning=(
            "On line the wrench comes from a force sensor: how much accuracy is left? Models "
            "learn from clean wrenches; fit and draws are the same at every level."
        ),
    ),
    ProtocolInfo(
        key="path-compensation",
        target="stiff_protocols.splits.path_compensation:PathCompensation",
        summary="error left on tool paths that a simulated robot drives with corrected commands",
        reasoning=(
            "What is a model worth at the part? It learns as under holdout and corrects 36 paths; "
            "the twin drives them under load. The rows are path errors, not errors of predictions. "
            "It requires simulated data: a measured robot cannot be measured again."
        ),
    ),
    ProtocolInfo(
        key="holdout-paths",
        target="stiff_protocols.splits.path_compensation:HoldoutPaths",
        summary="holdout, and the error that the same fits leave on simulated tool paths",
        reasoning=(
            "Does a small error at test poses make a straight path? One fit answers both: its "
            "metrics are holdout's, and the error left on 36 paths is shown with them. The "
            "leaderboard uses it."
        ),
    ),
    ProtocolInfo(
        key="cross-robot",
        target="stiff_protocols.splits.cross_robot:CrossRobot",
        summary="pre-train on another robot's or specimen's VJM, fine-tune on this one",
        reasoning=(
            "Does each robot need its own source domain? The same divisions are tested with"
            " the target's own source and with the foreign one; models without a source give the "
            "row to beat. All samples of the source are used: none of them is the target's."
        ),
    ),
    ProtocolInfo(
        key="nested",
        target="stiff_protocols.tuning.inner_search:Nested",
        summary="holdout with options tuned by cross-validation on the training part",
        reasoning=(
            "How well does a model do without tuning by hand? Each split chooses the options "
            "without its test part. An option that you set is not searched; a model without a "
            "grid is fitted with its options and marked 'not tuned'. Seeds differ from holdout's."
        ),
    ),
    ProtocolInfo(
        key="paper-holdout",
        target="stiff_protocols.splits.random_splits:PaperHoldout",
        summary="as in the source paper: 80/20 by pose, the 20 % also picks the best epoch",
        reasoning=(
            "Only to reproduce the paper's figures. It is not fair, and its rows say so. "
            "`read_on=all` reports the errors of the same fits on all samples, those that they "
            "learned from among them, as the paper's Table 10 most likely does: no test at all."
        ),
        warning=(
            "paper-holdout picks the best epoch on the very samples it reports, as the source "
            "paper does: rows of models that choose an epoch are optimistic. Use 'holdout' for "
            "a fair comparison."
        ),
    ),
)
