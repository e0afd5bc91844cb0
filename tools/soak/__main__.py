"""All long proofs on real renders, one after the other: `make soak`. Exits 1 if one of them finds a contradiction.

python tools/soak

Each is a script of its own that can be run alone; --help says what it does. The results are kept in build/soak.json.
"""

import argparse
import subprocess
import sys
from pathlib import Path

from outcomes import PARTS


def main():
    """Run every part, whatever the others found."""
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    scripts = [Path(__file__).parent / f"{part}.py" for part in PARTS]
    codes = [subprocess.run([sys.executable, str(script)], check=False).returncode for script in scripts]
    sys.exit(max(codes))


if __name__ == "__main__":
    main()
