"""A path evaluated pose by pose: limits, deflection, closeness to singular poses.

A circle of the tool with varying tilt, as in milling. Broken limits are named; the deflection under a cutting force is
the compliance times the force, at every pose.
"""

import matplotlib.pyplot as plt
import numpy as np

import pm3dof_pin as pm
from pm3dof_pin.figures.style import ONE_COLUMN, house_style, save_figure

robot = pm.load("hexapod")
angle = np.linspace(0.0, 2.0 * np.pi, 361)
radius = 0.008
path = np.tile(robot.home_coordinates, (len(angle), 1))
path[:, 0] += radius * np.cos(angle)
path[:, 1] += radius * np.sin(angle)
path[:, 4] = 0.1 * np.sin(angle)  # tilts of up to 0.1 rad
poses = robot.solve(path, on_failure="nan")
outside = ~poses.within_limits
named = [g.name for k, g in enumerate(robot.limit_groups) if np.any(poses.broken_limits & np.uint32(1 << (k + 1)))]
print(f"{outside.sum()} of {len(poses)} poses break a limit of:", ", ".join(named) or "none")

C = pm.compliance(robot, poses, on_failure="nan")
cutting = np.array([30.0, 0.0, 100.0, 0.0, 0.0, 0.0])  # N at the tool
deflection = 1e6 * np.linalg.norm((C @ cutting)[:, :3], axis=1)
print(f"deflection {np.nanmin(deflection):.2f} to {np.nanmax(deflection):.2f} µm")

with house_style():
    figure, axes = plt.subplots(figsize=(ONE_COLUMN, 2.6), layout="constrained")
    axes.plot(np.degrees(angle), deflection, color="#08519c")
    whole = {"transform": axes.get_xaxis_transform(), "color": "#f4cccc"}
    axes.fill_between(np.degrees(angle), 0.0, 1.0, where=outside, **whole, label="breaks a limit")
    axes.set(xlabel="angle along the circle [deg]", ylabel="deflection [µm]", xlim=(0, 360))
    axes.legend()
save_figure(figure, "path.png")
