"""Elastic mechanisms: springs, the 6 x 6 Cartesian stiffness of any frame, loaded stiffness and buckling, indices.

Names are listed in `__init__.pyi` and loaded when they are first used: the indices need neither Pinocchio nor a
compiler.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
