"""A stiffness map of your robot.

A grid over two coordinates; the others stay at home. Programs compiled from the robot's model close all loops and
compute the stiffness at every pose, in microseconds a pose. The picture ends at the limits.
"""

import numpy as np

import pm3dof_pin as pm
from pm3dof_pin.figures.atlas import atlas_pictures
from pm3dof_pin.figures.style import save_figure
from pm3dof_pin.maps.grid_map import quantity_map
from pm3dof_pin.maps.quantity import MappedRobot

robot = pm.load("three_rps")
for coordinate in robot.coordinates:
    print(f"{coordinate.name} [{coordinate.unit}] from {coordinate.lower:.3f} to {coordinate.upper:.3f}")

tilt = np.radians(40.0)
grid = robot.grid(rx=(-tilt, tilt, 81), ry=(-tilt, tilt, 81))
found = quantity_map(MappedRobot(robot), grid, ["felt_stiffness"])  # an xarray.Dataset
felt = 1e-6 * found.felt_stiffness.sel(axis="z")  # felt by a probe that pushes along z, all else free [N/µm]
print(f"{int(felt.notnull().sum())} of {felt.size} poses are within all limits")
print(f"felt along z: {float(felt.min()):.3g} to {float(felt.max()):.3g} N/µm")

C = pm.compliance(robot, robot.home)  # the whole matrix: [v; omega] = C [f; m] at the tool
print(f"at home {1e-6 / C[2, 2]:.3g} N/µm")
save_figure(atlas_pictures(found.sel(axis=["z"]), robot)["felt_stiffness_z"], "stiffness_map.png")
