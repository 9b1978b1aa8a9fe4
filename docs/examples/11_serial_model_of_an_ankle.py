"""What to type into a serial model of an ankle: limits and armature over a box, and how wrong one constant is.

Two motors move pitch and roll together through cranks and rods. Training code has a joint each, with one number for
what depends on the pose; the least wrong number is printed with its error, and the torques are drawn over the poses.
"""

import numpy as np

import pm3dof_pin as pm
from pm3dof_pin.capability.serial_constants import serial_constants
from pm3dof_pin.capability.transmission import joint_driven, transmission
from pm3dof_pin.export.serial import serial_tree, write_serial
from pm3dof_pin.figures.style import save_figure
from pm3dof_pin.figures.transmission import transmission_pictures

closed = pm.load("ankle_rus")
ankle = joint_driven(closed, ["pitch_joint", "roll_joint"])
pitch, roll = np.radians([20.0, 10.0])
grid = ankle.grid(pitch_joint=(-pitch, pitch, 21), roll_joint=(-roll, roll, 21))
box = transmission(ankle, grid, on_failure="nan")

tree = serial_tree(closed, ankle)
constants = serial_constants(box, pm.load(tree))
for name, values in constants.values.items():
    for joint, value, error in zip(box.joints, values, constants.errors[name], strict=True):
        print(f"{joint:12} {name:9} {value:9.4g}, off by up to {100 * error:.0f} %")
for file in write_serial(closed, tree, constants, "serial"):
    print("wrote", file)

save_figure(transmission_pictures(box)["torque_polytopes"], "torques.png")
