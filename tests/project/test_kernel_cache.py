"""A package that nobody may write to, for a user without a home: kernels are compiled each time, and it says so."""

from __future__ import annotations

import subprocess
import sys

PROGRAM = """
from numba.core import caching
for entry in list(vars(caching).values()):  # as where no folder can be written
    if hasattr(entry, "_locator_classes"):
        entry._locator_classes = []
import pm3dof_pin as pm
from pm3dof_pin.elastic.indices import compliance
tripod = pm.Tripod.load()
print(pm.inverse_kinematics(tripod, [0.0, 0.0, 0.493]), compliance(pm.elastic_stiffness(tripod, tripod.home)).shape)
"""


def test_kernels_work_where_they_cannot_be_kept() -> None:
    result = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=True)
    assert result.stdout == "[0.24028054 0.24028054 0.24028054] (6, 6)\n"
    assert result.stderr.count("\n") == 1
    assert "compiled kernels cannot be kept" in result.stderr
    assert "NUMBA_CACHE_DIR" in result.stderr
