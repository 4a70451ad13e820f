# SPDX-License-Identifier: Apache-2.0
"""The command ``gsdf``, one module per subcommand."""
