"""The correction of a command by the predicted pseudo-error, and the source of the prediction (Fig. 8.6)."""

from __future__ import annotations

from drawings.diagram import NAMES, Diagram
from matplotlib.figure import Figure

from pm3dof_pin.figures.style import house_style


def compensation_flow_figure() -> Figure:
    """Draw the flow of the error compensation: above the path of every command, below the calibration."""
    with house_style():
        sheet = Diagram(9.6, 4.1)
        size, upper, lower = (1.55, 0.86), 3.17, 1.13
        sheet.frame((4.8, 3.27), (9.4, 1.44))
        sheet.text((0.2, 3.85), "at work: every command", "left", NAMES)
        sheet.frame((4.8, 1.12), (9.4, 2.02))
        sheet.text((3.85, 1.98), "calibration: once, at a few poses", "left", NAMES)
        wanted = sheet.box((1.1, upper), size, "Wanted pose", "$x$", fill="data")
        inverse = sheet.box((3.15, upper), size, "Inverse kinematics", "nominal", fill="model")
        correct = sheet.circle((4.95, upper))
        machine = sheet.box((6.55, upper), size, "Machine", "drives, legs, tool", fill="machine")
        real = sheet.box((8.6, upper), size, "Real pose", "$x'$", fill="result")
        sheet.arrow(wanted.right, inverse.left)
        sheet.arrow(inverse.right, correct.left)
        sheet.text((4.36, upper + 0.14), "$u$")
        sheet.arrow(correct.right, machine.left)
        sheet.text((5.42, upper + 0.16), r"$u - \delta\hat u$")
        sheet.arrow(machine.right, real.left)
        measured = sheet.box((8.6, lower), size, "Measurement", "of $x'$, with noise", fill="data")
        words = "nominal, of the measured\npose: $u'$; then $\\delta u = u' - u$"
        deviation = sheet.box((6.3, lower), (2.15, 0.86), "Inverse kinematics", words, fill="model")
        words = "network, Gaussian process\nor identified parameters"
        predicted = sheet.box((3.5, lower), (2.15, 0.86), r"Prediction $\delta\hat u(u)$", words, fill="model")
        error = sheet.box((1.1, lower), size, "Pose error", r"$E_{xyz} + \eta\,E_{\psi\theta\phi}$", fill="result")
        sheet.arrow(real.bottom, measured.top)
        sheet.arrow(measured.left, deviation.right)
        sheet.arrow(deviation.left, predicted.right)
        sheet.text((4.9, lower + 0.15), r"$(u,\ \delta u)$")
        sheet.arrow(predicted.top, (predicted.x, 2.34), (correct.x, 2.34), correct.bottom)
        sheet.text((5.03, upper - 0.24), "$-$", "left")
        sheet.arrow(wanted.bottom, error.top, dashed=True)
        sheet.arrow(measured.bottom, (measured.x, 0.4), (error.x, 0.4), error.bottom, dashed=True)
        sheet.text((4.8, 0.27), "the error of the pose, without and with the correction")
    return sheet.figure
