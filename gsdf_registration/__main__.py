# SPDX-License-Identifier: Apache-2.0
"""``python -m gsdf_registration`` is the command ``gsdf``."""

import runpy

if __name__ == '__main__':
    runpy.run_module('gsdf_registration.cli.main', run_name='__main__', alter_sys=True)
