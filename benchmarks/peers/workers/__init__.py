# SPDX-License-Identifier: Apache-2.0
"""
Scripts that run in the environments of the peers.

They import only numpy, the library of the peer and one another. A peer is a function that takes a
`Model` and returns an `Align`, all in metres.
"""
