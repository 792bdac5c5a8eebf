"""List the data sets of stiffbench."""

from __future__ import annotations

from functools import partial

from stiff_protocols.contract.plugin import DatasetInfo

_SIMULATED = "simulated, never measured; its constants are largely assumptions."
_kr10_twin = partial(
    DatasetInfo,
    kind="simulated",
    reference="constants and their sources: stiff_datasets/twins/kr10_r1100_2.toml",
    card="data/kr10_twin.md",
)

DATASETS = (
    _kr10_twin(
        key="kr10-twin",
        target="stiff_datasets.twin.kr10_twin:Kr10Twin",
        summary="KUKA KR10 R1100-2 twin, 151 poses, one load each as in the paper's Table 5",
        caveats=(f"kr10-twin is {_SIMULATED}",),
        published="table_10",
    ),
    _kr10_twin(
        key="kr10-twin-omni",
        target="stiff_datasets.twin.kr10_twin:Kr10TwinOmni",
        summary="the same twin and poses, forces in all directions at a hook up to the payload",
        caveats=(f"kr10-twin-omni is {_SIMULATED}",),
    ),
    _kr10_twin(
        key="kr10-twin-multiload",
        target="stiff_datasets.twin.kr10_twin:Kr10TwinMultiload",
        summary="the same twin and poses, five loads each as in the paper's Table 5",
        caveats=(f"kr10-twin-multiload is {_SIMULATED}",),
    ),
    DatasetInfo(
        key="ur5-twin",
        target="stiff_datasets.twin.robot_twin:Ur5Twin",
        kind="simulated",
        summary="twin of a UR5 (5 kg), 151 random poses, forces in all directions at a hook",
        reference="constants and their sources: stiff_datasets/twins/ur5.toml",
        caveats=(f"ur5-twin is {_SIMULATED}", "ur5-twin: no constant was identified on a UR5."),
        card="data/ur5_twin.md",
    ),
    DatasetInfo(
        key="arm-family",
        target="stiff_datasets.twin.robot_twin:ArmFamily",
        kind="simulated",
        summary="twins of ten types of arm, 3 to 240 kg (robot=0..9): 151 random poses, pulled at "
        "a hook",
        reference="constants and their sources: stiff_datasets/twins/, one file per robot",
        caveats=(
            f"arm-family is {_SIMULATED}",
            "arm-family: no constant was identified on the robots that lend their kinematics.",
        ),
        card="data/arm_family.md",
    ),
    DatasetInfo(
        key="fresh-arms",
        target="stiff_datasets.twin.fresh_arms:FreshArms",
        kind="simulated",
        summary="twin of an arm that the seed draws, 3 to 300 kg: 151 random poses, pulled at a "
        "hook",
        reference="rules of the draw: stiff_datasets/twin/fresh_arms.py",
        caveats=(
            f"fresh-arms is {_SIMULATED}",
            "fresh-arms: no real robot has these kinematics.",
        ),
        card="data/fresh_arms.md",
    ),
    DatasetInfo(
        key="robot-twin",
        target="stiff_datasets.twin.robot_twin:RobotTwin",
        kind="simulated",
        summary="twin of your own robot: --set robot-twin.constants=FILE.toml",
        reference="format of the file: stiff_datasets/twin/twin_file.py",
        caveats=("robot-twin is simulated, never measured.",),
    ),
    DatasetInfo(
        key="fanuc-r2000ic",
        target="stiff_datasets.measured.fanuc_r2000ic:FanucR2000iC",
        kind="measured",
        summary="43 measured deflections of a FANUC R-2000iC under cable loads",
        reference="data card: stiff_datasets/data/fanuc_r2000ic.md",
        caveats=(
            "fanuc-r2000ic: the TCP given is the drill tip; whether the cable pulled there is not "
            "stated.",
            "fanuc-r2000ic: 43 samples cannot rank close methods.",
            "fanuc-r2000ic: torques were not recorded; they are zero in the data.",
        ),
        card="data/fanuc_r2000ic.md",
        licence="MIT",
    ),
    DatasetInfo(
        key="kr10-measured",
        target="stiff_datasets.measured.kr10_measured:Kr10Measured",
        kind="unknown",
        summary="your own KUKA KR10 measurement (stiffbench ships none)",
        caveats=("kr10-measured is a user's own file; how it was measured is not known here.",),
        published="table_10",
        missing_because="stiff_datasets.measured.kr10_measured:missing",
    ),
)

DRILLED_HOLES = DatasetInfo(
    key="fanuc-drilling",
    target="stiff_datasets.measured.drilled_holes:drilled_holes",
    kind="measured",
    summary="28 holes that a FANUC R-2000iC drilled, with their breakthrough surge",
    reference="data card: stiff_datasets/data/fanuc_drilling.md",
    card="data/fanuc_drilling.md",
    licence="MIT",
)
"""Used to check models; without deflections, models cannot be fitted to it."""

MEASURED_FILE = DatasetInfo(
    key="file",
    target="stiff_datasets.measured.sample_file:MeasuredData",
    kind="unknown",
    summary="a user's own CSV file and URDF (bench run --data FILE.csv --urdf FILE.urdf)",
)
"""Represents the file of `--data`; the engine uses the file's name as its key."""
