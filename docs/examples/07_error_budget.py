"""Where do the errors of the tool come from?

Geometry within its tolerances, heat, the load at work, drives, vibration: each alone and all together, over poses of
the whole workspace, and the part that remains with the best commands.
"""

import matplotlib.pyplot as plt
import numpy as np

import pm3dof_pin as pm
from pm3dof_pin.errors.error_budget import error_budget
from pm3dof_pin.errors.source_errors import ErrorSources
from pm3dof_pin.figures.style import TWO_COLUMNS, house_style, save_figure

errors = pm.GeometricErrors.load("pm3dof")
poses = pm.reachable_poses(errors.robot, 400, np.random.default_rng(0))
budget = error_budget(ErrorSources(errors, wrench=[100.0, 0.0, 0.0, 0.0, 0.0, 0.0]), poses)
lines = budget.lines()
for line in lines:
    print(f"{line.name:20s} {1e6 * line.tip_rms:8.1f} µm rms, {1e6 * line.left:7.1f} µm left with the best commands")

with house_style():
    figure, axes = plt.subplots(figsize=(TWO_COLUMNS, 3.0), layout="constrained")
    names = [line.name.replace("_", " ") for line in lines]
    axes.barh(names, [1e6 * line.tip_rms for line in lines], color="#9ecae1", label="as built")
    axes.barh(names, [1e6 * line.left for line in lines], height=0.45, color="#08519c", label="with the best commands")
    axes.set(xlabel="tip error, rms over the workspace [µm]")
    axes.invert_yaxis()
    axes.legend()
save_figure(figure, "error_budget.png")
