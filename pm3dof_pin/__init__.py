"""Kinematics, stiffness and calibration of closed-chain robots on Pinocchio.

The public names are listed in `__init__.pyi` and loaded on first use, which keeps `import pm3dof_pin` fast. Everything
else is imported from its module. Results specific to the machine of chapter 8 of D. Zhang, Parallel Robotic Machine
Tools (Springer 2010), are in :mod:`pm3dof_pin.chapter`.
"""

import lazy_loader

__version__ = "0.2.0"

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
