"""Fill in a plan with a simulated measurement: python standin.py PLAN OUTPUT."""

import sys
from pathlib import Path

import numpy as np
import pandas as pd

from stiff_datasets.twin.experiment import recorded_deflection, recorded_wrench
from stiff_datasets.twin.twin import DigitalTwin
from stiff_datasets.twin.twin_file import read_constants

plan = pd.read_csv(sys.argv[1])
constants = read_constants(Path(__file__).with_name("my_robot.toml"))
twin = DigitalTwin.in_world(constants, specimen=0, world="clean")
rng = np.random.default_rng(0)
load = ["fx_N", "fy_N", "fz_N", "tx_Nm", "ty_Nm", "tz_Nm"]
angles = [name for name in plan.columns if name.endswith("_deg")]

q = np.deg2rad(plan[angles].to_numpy(float))
true = plan[load].fillna(0.0).to_numpy(float)
plan[load] = recorded_wrench(true, constants.noise, rng)
deflection = recorded_deflection(twin.truth(q, true), constants.noise, rng)
plan[["dx_mm", "dy_mm", "dz_mm"]] = (1000.0 * deflection).round(5)
plan.to_csv(sys.argv[2], index=False)
