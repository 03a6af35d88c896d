"""What must be settled before anything of PyTorch is loaded, so that results do not depend on where numbers lie.

MKL, with which PyTorch multiplies matrices on x86-64, chooses its instructions by where in memory a matrix begins, and
so rounds a run's numbers differently beside other runs. In this mode it does not (Intel's *conditional numerical
reproducibility*); no cost could be measured. MKL reads it at its first product; who has set it otherwise keeps that.
"""

from __future__ import annotations

import os

os.environ.setdefault("MKL_CBWR", "AUTO,STRICT")
