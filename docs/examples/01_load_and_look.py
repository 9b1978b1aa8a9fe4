"""Load a robot and look at it.

A robot is loaded by its name or by the path of its files. Its coordinates describe a pose, its commands are the counter
readings of its drives. The page that is written at the end needs no network and no Python.
"""

import pm3dof_pin as pm

robot = pm.load("hexapod")  # or "your_robot.urdf", "robot.yaml", "machine.xml"
print(robot)

pose = robot.solve([0.004, 0.0, 0.137, 0.0, 0.05, 0.0])  # x, y, z [m], then three angles [rad]
for command, value in zip(robot.commands, pose.commands, strict=True):
    print(f"{command.name} {1e3 * value:8.4f} mm")
print("within all limits:", bool(pose.within_limits), f"- loops closed to {pose.residual:.0e} m")

model = pm.ElasticModel(robot)
C = pm.cartesian_compliance(model, pose.configuration()).compliance
with pm.Viewer(robot) as viewer:
    viewer.display(pose.configuration())
    viewer.stiffness_ellipsoid(compliance=C)
    print("open", viewer.save_html("hexapod.html"))
