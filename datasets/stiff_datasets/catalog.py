"""The data sets that stiffbench ships."""

from __future__ import annotations

from stiff_protocols.plugin import DatasetInfo

DATASETS = (
    DatasetInfo(
        key="kr10-twin",
        target="stiff_datasets.kr10_twin:Kr10Twin",
        kind="simulated",
        summary="151 poses of the source paper's plan on a digital twin of the KUKA KR10 R1100-2",
        reference="constants and their sources: stiff_datasets/kr10_twin.py",
        caveats=("kr10-twin is simulated, never measured; its constants are largely assumptions.",),
        published="table_10",
    ),
    DatasetInfo(
        key="fanuc-r2000ic",
        target="stiff_datasets.fanuc_r2000ic:FanucR2000iC",
        kind="measured",
        summary="43 real deflections of a FANUC R-2000iC under cable loads",
        reference="data card: stiff_datasets/data/fanuc_r2000ic.md",
        caveats=(
            "fanuc-r2000ic: the TCP given is the drill tip; whether the cable pulled there is not "
            "stated.",
            "fanuc-r2000ic: 43 samples cannot rank close methods.",
            "fanuc-r2000ic: torques were not recorded; they are zero in the data.",
        ),
    ),
)

MEASURED_FILE = DatasetInfo(
    key="file",
    target="stiff_datasets.measured:MeasuredData",
    kind="measured",
    summary="a user's own CSV file and URDF (bench run --data FILE.csv --urdf FILE.urdf)",
)
"""Stands for the file that `--data` names; the engine gives it that file's name as its key."""
