"""Kinematics, stiffness and calibration of closed-chain robots on Pinocchio.

The public names are listed in `__init__.pyi` and loaded when they are first used, so that `import pm3dof_pin` costs
nothing. Everything else is reached by its module; what is known of one machine only, that of chapter 8 of D. Zhang,
Parallel Robotic Machine Tools (Springer 2010), is in :mod:`pm3dof_pin.chapter`.
"""

import lazy_loader

__version__ = "0.2.0"

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
