# SPDX-License-Identifier: Apache-2.0
"""The messages of gsdf_registration_msgs pass between two processes."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from gsdf_registration.clients.operator import Operator
from msg_adapters import results

pytestmark = [
    pytest.mark.ros,
    pytest.mark.skipif(not results.available(),
                       reason='gsdf_registration_msgs is not built, see tools/build_messages.py')]


@pytest.fixture
def client() -> Iterator[Operator]:
    server = subprocess.Popen([sys.executable, str(Path(__file__).with_name('result_server.py'))],
                              cwd=Path(__file__).parents[2])
    with Operator('/result_server', alive=lambda: server.poll() is None, patience=30.0) as operator:
        yield operator
    server.kill()
    server.wait()


def test_a_late_joiner_receives_a_result_and_its_withdrawal(client: Operator) -> None:
    from gsdf_registration_msgs.msg import RegistrationResult
    from gsdf_registration_msgs.srv import Register

    message = client.receive(RegistrationResult, '~/result')
    assert message.valid and message.reason == RegistrationResult.CONVERGED
    assert message.target_names == ['cup'] and list(message.target_tre) == [6e-4]
    assert (message.header.frame_id, message.session_id, message.registration_id) == (
        'tracker', 'a1b2', 1)

    request = Register.Request(use_initial_pose=True)
    request.initial_pose.pose.position.x = 0.125
    response = client.result(client.start(Register, 'register_with', request))
    assert response.success and response.result.pose.pose.position.x == 0.125

    message = client.receive(RegistrationResult, '~/result')
    assert not message.valid and message.reason == RegistrationResult.CLEARED
