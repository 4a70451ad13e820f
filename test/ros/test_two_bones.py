# SPDX-License-Identifier: Apache-2.0
"""Two nodes in two namespaces, with default names of frames and files, and one probe."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from ros_support import BAG, ROOT, Client, NodeProcess, Tracker

from gsdf_registration.common.rigid import Array, exp
from msg_adapters import ros

pytestmark = pytest.mark.ros
BAGS = {'hip': BAG, 'femur': BAG.with_name('femur_em')}
STILL = np.eye(4)
MAX_ERROR = 2e-3        # m at the landmarks; the noise of the electromagnetic tracker is 0.4 mm


class Bone(NamedTuple):
    """A bone with its node and the tracker that touches it."""

    name: str
    node: NodeProcess
    tracker: Tracker

    @property
    def client(self) -> Client:
        return self.tracker.client

    def register(self, T_moved: Array) -> None:
        """Touch the bone at its moved place, and register it."""
        self.tracker.drag(T_moved)
        answer = self.client.ask('register')
        assert answer.success, answer.message

    def transform(self) -> tuple[str, Array]:
        """Return the parent frame and the pose on /tf of the child frame of this bone."""
        from tf2_msgs.msg import TFMessage
        message = self.client.receive(
            TFMessage, '/tf', 10, lambda message: message.transforms[0].child_frame_id
            == f'{self.name}_bone')
        _, T, parent, _ = ros.transform_from(message.transforms[0])
        return parent, T


@pytest.fixture
def bones(tmp_path: Path) -> Iterator[dict[str, Bone]]:
    """Return both bones with active nodes that share one folder."""
    pytest.importorskip('tf2_msgs.msg', reason='tf2_msgs is not installed')
    settings = ('--params-file', str(ROOT / 'examples/two_bones.yaml'))
    nodes = {name: NodeProcess(tmp_path / f'{name}.log', options=settings, namespace=name,
                               **{'model.path': BAG.with_name(f'{name}.ply')}) for name in BAGS}
    try:
        with Client(nodes['hip']) as hip, Client(nodes['femur']) as femur:
            bones = {}
            for client, (name, bag) in zip((hip, femur), BAGS.items()):
                client.await_state('active')
                tracker = Tracker(client, ['/probe/tip'], bag)
                tracker._stamp = 1000.0 * (1 + len(bones))      # one clock for both
                tracker.await_listener()
                bones[name] = Bone(name, nodes[name], tracker)
            yield bones
    finally:
        for node in nodes.values():
            node.stop()


def test_both_bones_are_registered_and_one_is_moved(bones: dict[str, Bone],
                                                    tmp_path: Path) -> None:
    hip, femur = bones['hip'], bones['femur']
    hip.tracker._stamp = femur.tracker._stamp + 100.0
    hip.register(STILL)
    femur.tracker._stamp = hip.tracker._stamp + 100.0
    femur.register(STILL)
    for bone in bones.values():
        parent, T = bone.transform()
        assert parent == 'tracker'
        bone.tracker.assert_near_truth(T, STILL, MAX_ERROR)

    T_moved = exp(np.array([0.1, -0.1, 0.1, 0.03, 0.02, -0.05]))
    assert femur.client.ask('clear').success
    femur.tracker._stamp += 100.0
    femur.register(T_moved)
    femur.tracker.assert_near_truth(femur.transform()[1], T_moved, MAX_ERROR)
    hip.tracker.assert_near_truth(hip.transform()[1], STILL, MAX_ERROR)

    for bone in bones.values():
        assert bone.client.ask('save').success
    written = {file.name for file in tmp_path.iterdir() if file.suffix == '.json'}
    assert written == {'hip_registration_session.json', 'femur_registration_session.json'}
    assert all((tmp_path / f'{name}.journal').exists() for name in written)
    assert not any('Traceback' in bone.node.log for bone in bones.values())

    # another program that sends the transform of one of them is reported there, and only there
    from tf2_msgs.msg import TFMessage
    publisher = hip.client.node.create_publisher(TFMessage, '/tf', 10)

    def warned(bone: Bone) -> bool:
        stamp = hip.client.node.get_clock().now().to_msg()
        publisher.publish(TFMessage(transforms=[
            ros.transform_msg(T_moved, 'world', 'hip_bone', stamp)]))
        return 'another program sends a transform of hip_bone' in bone.client.status()['message']
    hip.client.spin_until(lambda: warned(hip), 'nothing is reported')
    assert not warned(femur)
    assert 'another program sends a transform of hip_bone' in hip.node.log
