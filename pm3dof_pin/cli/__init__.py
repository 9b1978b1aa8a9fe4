"""The command `pm3dof`. Modules here import nothing heavy at the top, so that `pm3dof --help` is instant."""

import gc

# modules are kept, so looking for rubbish among some 100,000 new objects is in vain: a tenth of a short command's time
gc.set_threshold(100_000, 10, 10)
