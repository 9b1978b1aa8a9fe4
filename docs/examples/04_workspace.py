"""Where can it go?

The reachable set under all limits of joints and closures, section by section: ranges and areas, and each limit's name
and share of the boundary. The picture shows every edge between two limits.
"""

import numpy as np

import pm3dof_pin as pm
from pm3dof_pin.figures.style import save_figure
from pm3dof_pin.figures.workspace import workspace_figure
from pm3dof_pin.maps.limit_space import robot_space
from pm3dof_pin.maps.workspace import workspace

robot = pm.load("pm3dof")
found = workspace(robot_space(robot), levels=11, directions=72)  # the first three coordinates; others stay at home
low, high = found.level_range
print(f"{found.space.names[2]} from {low:.4f} to {high:.4f} m")
for name, (least, greatest) in zip(found.space.names, np.degrees(found.ranges), strict=False):
    print(f"{name} from {least:.2f} to {greatest:.2f} deg")
shares = {name: share for name, share in found.limit_shares.items() if share}
print("limited by", ", ".join(f"{name} ({100 * share:.0f} % of the boundary)" for name, share in shares.items()))
save_figure(workspace_figure(found), "workspace.png")
