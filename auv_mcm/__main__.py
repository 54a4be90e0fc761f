"""python -m auv_mcm, the same as the auv-mcm command."""

import sys

from auv_mcm.cli import main

if __name__ == "__main__":
    sys.exit(main())
