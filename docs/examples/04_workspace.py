"""Where can it go?

The reachable set under all limits of joints and closures, as lines that are found to the last digit, section by
section. What limits it, and how much of the boundary, is known by name.
"""

import matplotlib.pyplot as plt
import numpy as np

import pm3dof_pin as pm
from pm3dof_pin.maps.limit_space import robot_space
from pm3dof_pin.maps.workspace import level_range
from pm3dof_pin.maps.workspace_section import limit_shares, workspace_sections

robot = pm.load("pm3dof")
space = robot_space(robot)  # over the first three coordinates; others stay at home
low, high = level_range(space)
print(f"{space.names[2]} from {low:.4f} to {high:.4f} m")

figure, axes = plt.subplots(figsize=(4.2, 3.6), layout="constrained")
levels = np.linspace(low, high, 8)[1:-2]
for level, section in zip(levels, workspace_sections(space, levels, 180), strict=True):
    outline = np.degrees(np.vstack([section.points, section.points[:1]]))
    axes.plot(*outline.T, label=f"{level:.3f} m")
shares = limit_shares(space, section.limits)
print(
    f"at {level:.3f} m limited by", ", ".join(f"{name} {100 * share:.0f} %" for name, share in shares.items() if share)
)
axes.set(xlabel="theta_x [deg]", ylabel="theta_y [deg]", aspect="equal", title="Sections of the workspace")
axes.legend(title="z_e", loc="center left", bbox_to_anchor=(1.0, 0.5))
figure.savefig("workspace.png", dpi=150)
