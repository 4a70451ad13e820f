# SPDX-License-Identifier: Apache-2.0
"""
Scripts, run by the Pythons of the peers' environments.

They import nothing but numpy, the peer's library and one another; a peer is a function here that
takes a `Model` and returns an `Align`, all in metres.
"""
