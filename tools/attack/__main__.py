"""Damaged and hostile files for every reader: `make attack`. Exits 1 if one crashes, hangs, deceives or escapes.

python tools/attack [--scale 1] [--seed 0] [--only KIND] [--jobs 2] [--tree CHECKOUT] [--json FILE] [--keep FOLDER]
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2] / "tests" / "support"))
sys.path.insert(0, str(Path(__file__).parents[1]))

from attack.harness import main

if __name__ == "__main__":
    main()
