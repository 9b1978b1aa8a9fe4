"""A stiffness map of your robot.

A grid over two coordinates; those that are not named stay at home. All loops are closed and the 6 x 6 compliance is
computed at every pose by programs that are made from the robot's model, microseconds a pose.
"""

import matplotlib.pyplot as plt
import numpy as np

import pm3dof_pin as pm

robot = pm.load("three_rps")
for coordinate in robot.coordinates:
    print(f"{coordinate.name} [{coordinate.unit}] from {coordinate.lower:.3f} to {coordinate.upper:.3f}")

tilt = np.radians(20.0)
poses = robot.solve(robot.grid(rx=(-tilt, tilt, 81), ry=(-tilt, tilt, 81)), on_failure="nan")
C = pm.compliance(robot, poses, on_failure="nan")  # (81, 81, 6, 6), [v; omega] = C [f; m] at the tool
C[~poses.within_limits] = np.nan
felt = 1e-6 / C[..., 2, 2]  # what a probe feels that pushes along z, all else free [N/µm]
print(f"{poses.within_limits.sum()} of {felt.size} poses are within all limits")
print(f"felt along z: {np.nanmin(felt):.3g} to {np.nanmax(felt):.3g} N/µm")

degrees = np.degrees(poses.coordinates)
figure, axes = plt.subplots(figsize=(4.2, 3.4), layout="constrained")
drawn = axes.contourf(degrees[..., 1], degrees[..., 2], felt, levels=20)
axes.set(xlabel="rx [deg]", ylabel="ry [deg]", aspect="equal", title="Stiffness felt along z")
figure.colorbar(drawn, label="N/µm")
figure.savefig("stiffness_map.png", dpi=150)
