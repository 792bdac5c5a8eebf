"""A pandas DataFrame is fitted, scored and predicted like a file with its columns."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

import stiffbench as sb
from stiff_datasets.measured.sample_columns import DEFLECTION_COLUMNS
from stiff_protocols.contract.errors import ConfigError, DataError, StiffBenchWarning

ROBOT = "kr10-r1100-2"


@pytest.fixture(scope="module")
def twin():
    return sb.load_dataset("kr10-twin", specimen=3)


@pytest.fixture()
def frame(twin):
    return twin.frame()


@pytest.fixture(scope="module")
def model(twin):
    return sb.make_model("vjm").fit(twin)


def test_a_model_of_a_frame_is_the_one_of_its_data_set(frame, twin, model):
    fitted = sb.make_model("vjm").fit(frame, robot=ROBOT)
    expected = model.predict(twin.samples.q, twin.samples.wrench)
    np.testing.assert_allclose(fitted.predict(frame), expected, atol=1e-15)
    pd.testing.assert_frame_equal(fitted.score(frame), model.score(twin))
    interval = fitted.predict_interval(frame)
    assert ((interval.lower <= expected) & (expected <= interval.upper)).all()


def test_loads_need_no_deflections_and_take_other_names_and_units(frame, model):
    loads = frame.drop(columns=[*DEFLECTION_COLUMNS, "pose_id"])
    in_rad = loads.assign(q1_deg=np.radians(loads["q1_deg"])).rename(columns={"q1_deg": "A1 [rad]"})
    np.testing.assert_allclose(model.predict(in_rad), model.predict(loads), atol=1e-12)


def test_missing_columns_are_named(frame, model):
    for use in (
        lambda table: sb.make_model("vjm").fit(table, robot=ROBOT),
        model.score,
        lambda table: sb.Dataset.from_frame(table, model.fitted.robot_),
    ):
        with pytest.raises(DataError, match=r"missing q2_deg, dx_mm \("):
            use(frame.drop(columns=["q2_deg", "dx_mm"]))


@pytest.mark.parametrize(
    ("column", "value", "expected"),
    [("ty_Nm", pd.NA, "'<NA>', expected a finite"), ("q3_deg", 170.0, "'170.0', expected -120..")],
)
def test_a_wrong_value_is_named_with_its_column_and_its_row_counted_from_zero(
    frame, column, value, expected
):
    frame = frame.astype({column: object}).set_index(np.arange(1000, 1151))
    frame.iloc[4, frame.columns.get_loc(column)] = value
    with pytest.raises(DataError, match=rf"row 4, column {column}: {expected}"):
        sb.make_model("vjm").fit(frame, robot=ROBOT)


def test_empty_and_repeated_tables_are_refused_in_one_line(frame, twin):
    twice = pd.concat([frame, frame.fx_N], axis=1)
    for table, words in (
        (pd.DataFrame(), "missing q1_deg"),
        (frame.iloc[:0], "no data rows"),
        (twice, "repeated fx_N"),
    ):
        with pytest.raises(DataError, match=words) as refused:
            sb.make_model("vjm").fit(table, robot=twin.robot)
        assert "\n" not in str(refused.value)


def test_rows_without_pose_id_become_poses_with_a_warning(frame):
    with pytest.warns(StiffBenchWarning, match="grouped into 151 poses"):
        sb.make_model("zero").fit(frame.drop(columns="pose_id"), robot=ROBOT)


def test_the_robot_is_given_with_a_frame_and_only_there(frame, twin, model):
    with pytest.raises(ConfigError, match=r"a DataFrame needs a robot; .*robot=\.\.\."):
        sb.make_model("vjm").fit(frame)
    with pytest.raises(ConfigError, match="a DataFrame needs a robot"):
        sb.evaluate("vjm", frame)
    with pytest.raises(ConfigError, match=r"^robot "):
        sb.make_model("vjm").fit(twin, robot=ROBOT)
    with pytest.raises(ConfigError, match="unknown robot 'kr11'"):
        sb.make_model("vjm").fit(frame, robot="kr11")
    for given in ((twin.samples.q,), (frame, twin.samples.wrench)):
        with pytest.raises(ConfigError, match=r"^wrench "):
            model.predict(*given)
