"""Plan the measurements, calibrate, and check the result.

A machine with errors of every part within its tolerances is simulated. Its thirty most informative poses are measured,
with noise; then its errors are compared at poses that were not measured.
"""

import matplotlib.pyplot as plt
import numpy as np

import pm3dof_pin as pm
from pm3dof_pin.errors.pose_error import pose_difference, tip_error
from pm3dof_pin.figures.style import ONE_COLUMN, house_style, save_figure
from pm3dof_pin.simulation.worlds import World

generator = np.random.default_rng(1)
errors = pm.GeometricErrors.load("hexapod")
robot = errors.robot
machine = World.random("geometry", errors, generator)
problem = pm.PlanningProblem(errors, pm.reachable_poses(robot, 300, generator))
plan = problem.plan(30, "d-optimal", generator, restarts=2)
measurements = machine.measure(plan.poses.commands, generator)
calibration = pm.calibrate(measurements, errors, "lm")

wanted = pm.reachable_poses(robot, 60, generator)
uncorrected = machine.poses(wanted.commands, {})
corrected = machine.poses(calibration.compensate(wanted.transforms).commands, {})
before, after = (1e6 * tip_error(pose_difference(wanted.transforms, real)) for real in (uncorrected, corrected))
print(f"tip error {np.sqrt(np.mean(before**2)):.0f} µm before, {np.sqrt(np.mean(after**2)):.0f} µm after, rms")

with house_style():
    figure, axes = plt.subplots(figsize=(ONE_COLUMN, 2.6), layout="constrained")
    axes.plot(np.sort(before), np.linspace(0, 100, 60), label="uncorrected")
    axes.plot(np.sort(after), np.linspace(0, 100, 60), label="calibrated")
    axes.set(xlabel="tip error [µm]", ylabel="poses below [%]", xscale="log")
    axes.legend()
save_figure(figure, "calibrated.png")
