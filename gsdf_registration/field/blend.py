# SPDX-License-Identifier: Apache-2.0
"""
Trilinear interpolation of a cell with SIMD instructions, two nodes of four components each.

Written in plain Python, the compiler processes the components one by one, which takes 1.5 times as
long per sample.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic

_LANE = ir.IntType(32)
_NODE = ir.VectorType(ir.FloatType(), 4)
_EDGE = ir.VectorType(ir.FloatType(), 8)


def _blend_nodes(_, nodes, at, stride_x, stride_y, u, v, w):
    """
    Interpolate the eight nodes of a cell at (u, v, w) in [0, 1]^3.

    Returns seven float32: the interpolated (d, gx, gy, gz), and the differences across the cell of
    gx along x, gy along y and gz along z.

    nodes : (m, 4) float32, C order; the neighbour along z of a node is the next row
    at : uint64, row of the first node of the cell
    stride_x, stride_y : uint64, number of rows to the neighbours along x and y
    u, v, w : float32
    """
    number, index = types.float32, types.uint64
    signature = types.UniTuple(number, 7)(nodes, index, index, index, number, number, number)

    def generate(context, b, signature, arguments):
        nodes, at, stride_x, stride_y, u, v, w = arguments
        first = context.make_array(signature.args[0])(context, b, nodes).data
        first = b.bitcast(first, _NODE.as_pointer())

        def edge(at):
            """Load a node and its neighbour along z."""
            both = b.load(b.bitcast(b.gep(first, [at]), _EDGE.as_pointer()))
            both.align = 4
            return both

        def lanes(vector, which):
            which = ir.Constant(ir.VectorType(_LANE, len(which)), which)
            return b.shuffle_vector(vector, ir.Constant(vector.type, ir.Undefined), which)

        def broadcast(number, kind):
            vector = b.insert_element(ir.Constant(kind, ir.Undefined), number, _LANE(0))
            return lanes(vector, [0] * kind.count)

        def across(low, high, share):
            """Return the interpolation between two sides, and their difference."""
            change = b.fsub(high, low)
            fused = ('contract',)
            return b.fadd(low, b.fmul(share, change, flags=fused), flags=fused), change

        def along_z(edge):
            return across(lanes(edge, [0, 1, 2, 3]), lanes(edge, [4, 5, 6, 7]), w)

        u, v, w = broadcast(u, _EDGE), broadcast(v, _EDGE), broadcast(w, _NODE)
        beyond = b.add(at, stride_x)
        low, low_y = across(edge(at), edge(b.add(at, stride_y)), v)
        high, high_y = across(edge(beyond), edge(b.add(beyond, stride_y)), v)
        blend, change_x = across(low, high, u)
        change_y, _ = across(low_y, high_y, u)
        blend, change_z = along_z(blend)
        picked = [(blend, 0), (blend, 1), (blend, 2), (blend, 3), (along_z(change_x)[0], 1),
                  (along_z(change_y)[0], 2), (change_z, 3)]
        return context.make_tuple(b, signature.return_type,
                                  [b.extract_element(x, _LANE(lane)) for x, lane in picked])

    return signature, generate


blend_nodes: Any = intrinsic(_blend_nodes)
