# SPDX-License-Identifier: Apache-2.0
"""``python -m gsdf_registration`` is the command ``gsdf``."""

import sys

from gsdf_registration.cli.main import main

if __name__ == '__main__':
    sys.exit(main())
