"""From the sources of error to the error of the pose, and the one pseudo-error that stands for them (Fig. 8.5)."""

from __future__ import annotations

import numpy as np
from drawings.diagram import NAMES, Diagram
from matplotlib.figure import Figure

from pm3dof_pin.figures.style import house_style


def pseudo_error_figure() -> Figure:
    """Draw Table 8.4 and Fig. 8.5 of the chapter, and the part that the three drives cannot represent."""
    with house_style():
        sheet = Diagram(9.6, 4.05)
        sheet.frame((1.63, 2.55), (2.96, 2.86))
        sheet.text((0.25, 3.84), "quasi-static errors", "left", NAMES)
        size, middle = (2.62, 0.72), 2.42
        geometry = sheet.box((1.63, middle + 0.86), size, "Geometry", "manufacturing and assembly", fill="data")
        heat = sheet.box((1.63, middle), size, "Heat", "growth of screws, links, frame", fill="data")
        load = sheet.box((1.63, middle - 0.86), size, "Load", "deflection of links and joints", fill="data")
        vibration = sheet.box((1.63, 0.5), size, "Vibration", "of tool, axes and motors", fill="plain", dashed=True)
        size = (1.72, 1.0)
        words = "one deviation $\\delta u(u)$\nof the joint variables"
        pseudo = sheet.box((4.35, middle), size, "Pseudo-error", words, fill="model")
        forward = sheet.box((6.45, middle), size, "Kinematics", "nominal, with\n$u + \\delta u$", fill="model")
        words = "position $E_{xyz}$ and\nangle $E_{\\psi\\theta\\phi}$"
        error = sheet.box((8.55, middle), size, "Pose error", words, fill="result")
        join = 3.3
        for box in (geometry, heat, load):
            sheet.arrow(box.right, (join, box.y), (join, middle), pseudo.left)
        sheet.arrow(pseudo.right, forward.left)
        sheet.arrow(forward.right, error.left)
        sheet.arrow((join, geometry.y), (join, 3.5), (error.x, 3.5), error.top, dashed=True)
        sheet.text((6.0, 3.66), "what three drives can neither cause nor undo of the six errors of a pose")
        inwards, outwards = (error.bottom + np.array([shift, 0.0]) for shift in (-0.3, 0.3))
        sheet.arrow(inwards, (inwards[0], 1.4), (pseudo.x, 1.4), pseudo.bottom, dashed=True)
        sheet.text((6.3, 1.24), "calibration: inverse kinematics of measured poses gives $\\delta u$")
        sheet.arrow(vibration.right, (outwards[0], vibration.y), outwards)
        sheet.text((5.9, vibration.y + 0.16), "does not repeat: no correction of the commands removes it")
    return sheet.figure
