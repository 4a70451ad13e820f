# SPDX-License-Identifier: Apache-2.0
"""Test the markers of ~/markers after deserialization by rclpy."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from geometry_msgs.msg import Point
from rclpy.serialization import deserialize_message, serialize_message
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from gsdf_registration.common.result import InputError
from gsdf_registration.visualization.decimation import decimate
from gsdf_registration.visualization.marker_scene import MAX_FACES
from msg_adapters import markers
from msg_adapters.marker_cdr import Shape, from_bytes, to_bytes

GREEN = np.array([0.0, 0.65, 0.46])
TRIANGLE = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.2, 0.0]])
FACE = np.array([[0, 1, 2]], np.int32)
NOTHING = np.zeros((0, 3))


def sent(shown: list[markers.Marker], frame_id: str = 'bone') -> dict[tuple[str, int], Marker]:
    """Return the deserialized markers by namespace and id."""
    array = deserialize_message(to_bytes(shown, frame_id), MarkerArray)
    found = {(marker.ns, marker.id): marker for marker in array.markers}
    assert len(found) == len(array.markers)
    return found


def numbers(items: list[Point] | list[ColorRGBA], names: str) -> np.ndarray:
    return np.array([[getattr(item, name) for name in names] for item in items])


@pytest.mark.parametrize('frame_id', ['', 'b', 'bo', 'bon', 'bone', 'femur_ct_lps'])
@pytest.mark.parametrize('labels', [[], ['1'], ['1: 0.8 mm', '2 \u2192 \u00fc']])
def test_serialization_agrees_with_rclpy(frame_id: str, labels: list[str]) -> None:
    """Test strings of different lengths, which determine the alignment of all other fields."""
    rng = np.random.default_rng(0)
    places = rng.normal(size=(len(labels), 3))
    shown = [*markers.points(rng.normal(size=(5, 3)), rng.uniform(size=(5, 3))),
             *markers.patches(places, np.tile([0.0, 0.6, 0.8], (len(labels), 1)), 0.008, labels,
                               GREEN),
             *markers.bone(TRIANGLE, FACE, np.eye(3))]
    written = to_bytes(shown, frame_id)
    array = deserialize_message(written, MarkerArray)
    assert len(serialize_message(array)) == len(written)
    for marker, read in zip(shown, array.markers, strict=True):
        assert (read.ns, read.id, read.text) == (marker.ns, marker.id, marker.text)
        assert (read.header.frame_id, read.lifetime.sec, read.frame_locked) == (frame_id, 0, True)
        plain = Marker(header=read.header, ns=read.ns, id=read.id, type=read.type, text=read.text,
                       action=read.action, pose=read.pose, scale=read.scale, color=read.color,
                       points=read.points, colors=read.colors, frame_locked=True)
        assert read == plain        # all other fields have their defaults


def test_reading_returns_what_was_written() -> None:
    segments = np.arange(12.0).reshape(2, 2, 3)
    written = [*markers.bone(TRIANGLE, FACE, np.eye(3)), *markers.border(segments, np.eye(3)[0]),
               *markers.patches(np.eye(3)[:1], np.eye(3)[2:], 0.008, ['1: 0.4 mm'], np.ones(3)),
               *markers.points(np.zeros((0, 3)), np.zeros((0, 3)))]
    read = from_bytes(to_bytes(written, 'bone'))
    assert [(each.ns, each.id, each.shape, each.text) for each in read] == [
        (each.ns, each.id, each.shape, each.text) for each in written if each.shape is not None]
    for one, other in zip(read, (each for each in written if each.shape is not None)):
        np.testing.assert_allclose(one.pose, np.eye(4) if other.pose is None else other.pose,
                                   atol=1e-12)
        np.testing.assert_array_equal(one.points, np.zeros((0, 3)) if other.points is None
                                      else other.points)
        assert one.scale == other.scale


def test_reading_rejects_what_is_no_marker_array() -> None:
    whole = to_bytes(markers.bone(TRIANGLE, FACE, np.eye(3)), 'bone')
    for part in (b'', whole[:40], whole[:-1]):
        with pytest.raises(InputError, match='is not a MarkerArray'):
            from_bytes(part)


def test_shapes_have_the_values_of_ros() -> None:
    known = {Shape.ARROW: Marker.ARROW, Shape.CYLINDER: Marker.CYLINDER,
             Shape.LINE_LIST: Marker.LINE_LIST,
             Shape.SPHERE_LIST: Marker.SPHERE_LIST, Shape.TEXT: Marker.TEXT_VIEW_FACING,
             Shape.TRIANGLE_LIST: Marker.TRIANGLE_LIST}
    assert set(known) == set(Shape)
    assert all(shape == number for shape, number in known.items())


def test_message_of_a_large_bone_is_smaller_than_2_mb() -> None:
    ball = trimesh.creation.icosphere(subdivisions=7, radius=0.1)
    vertices, faces = decimate(ball.vertices, ball.faces.astype(np.int32), MAX_FACES)
    most = np.ones((10_000, 3))
    size = len(to_bytes([*markers.bone(vertices, faces, np.ones((len(vertices), 3))),
                         *markers.points(most, most),
                         *markers.patches(most, most, 0.008, ['1: 0.8 mm'] * len(most), GREEN)],
                        'bone'))
    assert 1_000_000 < size < 2_000_000
    assert 120 * MAX_FACES + 40 * markers.MAX_POINTS + 10_000 < 2_000_000     # upper bound


def test_bone_is_a_triangle_list_with_colours() -> None:
    marker = sent(markers.bone(TRIANGLE, FACE[:, ::-1], np.eye(3)))['bone', 0]
    assert (marker.type, marker.action) == (Marker.TRIANGLE_LIST, Marker.ADD)
    assert numbers(marker.points, 'xyz') == pytest.approx(TRIANGLE[::-1])
    assert numbers(marker.colors, 'rgba') == pytest.approx(
        np.column_stack([np.eye(3)[::-1], np.ones(3)]))
    assert numbers([marker.scale], 'xyz') == pytest.approx(np.ones((1, 3)))   # 0 hides it
    assert (marker.header.frame_id, marker.header.stamp.sec, marker.frame_locked) == (
        'bone', 0, True)
    assert marker.pose.orientation.w == 1.0 and marker.color.a == 1.0


def test_bone_without_faces_is_a_list_of_spheres() -> None:
    marker = sent(markers.bone(TRIANGLE, np.zeros((0, 3), np.int32), np.eye(3)))['bone', 0]
    assert marker.type == Marker.SPHERE_LIST and 0.001 < marker.scale.x < 0.004
    assert numbers(marker.points, 'xyz') == pytest.approx(TRIANGLE)


def test_points_are_downsampled_spheres_with_colours() -> None:
    marker = sent(markers.points(TRIANGLE, np.eye(3)))['points', 0]
    assert marker.type == Marker.SPHERE_LIST and 0.001 < marker.scale.x < 0.004
    assert numbers(marker.points, 'xyz') == pytest.approx(TRIANGLE)
    assert numbers(marker.colors, 'rgb') == pytest.approx(np.eye(3))
    many = np.random.default_rng(0).normal(size=(9001, 3))
    drawn = numbers(sent(markers.points(many, many))['points', 0].points, 'xyz')
    assert 2000 < len(drawn) <= markers.MAX_POINTS
    assert drawn[:2] == pytest.approx(many[[0, 3]])


def test_patch_is_a_disc_with_an_arrow_along_the_normal_and_a_label() -> None:
    normal = np.array([0.6, 0.0, 0.8])
    shown = sent(markers.patches(TRIANGLE[1:2], normal[None], 0.008, ['1: 0.8 mm'], GREEN))
    disc, arrow, label = (shown[name, 0] for name in ('patch', 'patch_arrow', 'patch_label'))
    assert (disc.type, arrow.type, label.type) == (Marker.CYLINDER, Marker.ARROW,
                                                   Marker.TEXT_VIEW_FACING)
    assert (disc.scale.x, disc.scale.y) == pytest.approx((0.016, 0.016))    # the diameter
    for marker in (disc, arrow):
        assert numbers([marker.pose.position], 'xyz')[0] == pytest.approx(TRIANGLE[1])
        x, y, z, w = numbers([marker.pose.orientation], 'xyzw')[0]
        along = [2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)]
        assert along == pytest.approx(normal)
    tail, head = numbers(arrow.points, 'xyz')
    assert tail[2] > 0.01 and head == pytest.approx([0.0, 0.0, 0.0])    # toward the bone
    assert label.text == '1: 0.8 mm' and 0.004 < label.scale.z < 0.02
    assert label.scale.x == label.scale.z       # RViz: the width of a space
    assert numbers([label.pose.position], 'xyz')[0] @ normal > TRIANGLE[1] @ normal + 0.03
    assert 0.0 < disc.color.a < 1.0 and arrow.color.a == label.color.a == 1.0
    assert numbers([arrow.color], 'rgb')[0] == pytest.approx(GREEN)


def test_deletes_all_markers_that_are_not_shown() -> None:
    full = [*markers.points(TRIANGLE, np.eye(3)),
            *markers.patches(np.zeros((9, 3)), np.tile(np.eye(3)[2], (9, 1)), 0.008, ['n'] * 9,
                             GREEN)]
    none = [*markers.points(NOTHING, NOTHING), *markers.patches(NOTHING, NOTHING, 0.008, [], GREEN)]
    before, after = sent(full), sent(none)
    assert before.keys() == after.keys()
    assert {marker.action for marker in before.values()} == {Marker.ADD}
    assert {marker.action for marker in after.values()} == {Marker.DELETE}
