# SPDX-License-Identifier: Apache-2.0
"""The peers and their requirements."""

from __future__ import annotations

from dataclasses import dataclass

from benchmarks.peers.environment import Group

CURRENT = Group(
    'current', ('3.12', '3.11', '3.10'),
    # py-goicp is built from sources that do not declare their build requirements
    ('setuptools<80', 'wheel', 'numpy', 'cython<3.3', 'autowrap==0.22.11', 'open3d==0.20.0'),
    {'open3d': ('open3d==0.20.0',), 'small_gicp': ('small_gicp==1.0.1',),
     'meshlib': ('meshlib==3.1.4.297',), 'fricp-cpp': ('fricp-cpp==1.0.0',),
     'pycpd': ('pycpd==2.0.0',), 'rustcpd': ('rustcpd==4.0.0',),
     'jrmpc': ('jrmpc==1.0.0', 'tqdm'), 'py-goicp': ('py-goicp==0.0.4',),
     'kiss-matcher': ('kiss-matcher==1.0.2',),
     'scikit-surgerycore': ('scikit-surgerycore==0.8.3',),
     'closed form': ('open3d==0.20.0', 'small_gicp==1.0.1', 'scipy')})
OLD = Group(
    'python3.10', ('3.10',),
    # their extensions crash with numpy 2
    ('setuptools<80', 'wheel', 'numpy==1.26.4', 'open3d==0.20.0'),
    {'probreg': ('probreg==0.3.8',), 'cmeel-teaser-plusplus': ('cmeel-teaser-plusplus==2.0',)})


@dataclass(frozen=True)
class Peer:
    """
    A method of another library.

    worker : module and function in workers/
    guided : whether it needs an initial guess
    cost : of a trial: 0: less than a second, 1: seconds, 2: tens of seconds, 3: the time limit
    """

    name: str
    group: Group
    library: str
    worker: tuple[str, str]
    guided: bool
    cost: int = 0


PEERS = {peer.name: peer for peer in (
    Peer('Open3D', CURRENT, 'open3d', ('icp', 'open3d_tukey'), True),
    Peer('small_gicp', CURRENT, 'small_gicp', ('icp', 'small_gicp_plane'), True),
    Peer('MeshLib', CURRENT, 'meshlib', ('icp', 'meshlib_plane'), True),
    Peer('fricp-cpp', CURRENT, 'fricp-cpp', ('icp', 'fricp_plane'), True),
    Peer('FilterReg', OLD, 'probreg', ('mixtures', 'filterreg_plane'), True, 1),
    Peer('rustcpd', CURRENT, 'rustcpd', ('mixtures', 'rustcpd_rigid'), True, 1),
    Peer('pycpd', CURRENT, 'pycpd', ('mixtures', 'pycpd_rigid'), True, 2),
    Peer('JRMPC', CURRENT, 'jrmpc', ('mixtures', 'jrmpc_views'), True, 2),
    Peer('multi-start', CURRENT, 'small_gicp', ('global_methods', 'multi_start'), False, 1),
    Peer('KISS-Matcher', CURRENT, 'kiss-matcher', ('global_methods', 'kiss_matcher'), False, 1),
    Peer('TEASER++', OLD, 'cmeel-teaser-plusplus', ('global_methods', 'teaser'), False, 1),
    Peer('Go-ICP', CURRENT, 'py-goicp', ('global_methods', 'goicp'), False, 3),
)}

# those that state how accurate a pose is
STATING = {peer.name: peer for peer in (
    Peer('Open3D, information', CURRENT, 'open3d', ('accuracy', 'open3d_information'), True),
    Peer('small_gicp, information', CURRENT, 'small_gicp', ('accuracy', 'small_gicp_information'),
         True),
    Peer('ICP, Censi', CURRENT, 'closed form', ('accuracy', 'censi_plane'), True),
    Peer('ICP, Prakhya', CURRENT, 'closed form', ('accuracy', 'prakhya_point'), True),
    Peer('scikit-surgerycore', CURRENT, 'scikit-surgerycore', ('accuracy', 'surgerycore_tre'),
         True),
)}
