# SPDX-License-Identifier: Apache-2.0
"""Another bone for a running node: loaded beside the executor, taken when it is whole."""

from __future__ import annotations

import dataclasses
import traceback
from typing import TYPE_CHECKING

from rclpy.parameter import Parameter

from gsdf_registration.config import Config, ModelConfig
from gsdf_registration.model import find_model
from gsdf_registration.node.loading import load
from gsdf_registration.node.worker import Worker
from gsdf_registration.result import InputError, Reason

if TYPE_CHECKING:
    from gsdf_registration.node.node import RegistrationNode


class BoneExchange:
    """
    Loads the bone that ``model.*`` name from now on.

    Until it is there, and if it cannot be had, the old one stays; the points stay in any case.
    """

    def __init__(self, node: RegistrationNode) -> None:
        self.notice = ''        # one sentence while a bone is loaded, or after it could not be
        self._node = node
        self._worker = Worker()
        self._model = ModelConfig()     # of the bone in use

    def use(self, model: ModelConfig) -> None:
        """Know that the bone of these settings is in use."""
        self._model, self.notice = model, ''

    def wanted(self, config: Config) -> bool:
        """
        Tell whether ``config`` names another bone than that in use.

        Raises
        ------
        InputError
            When it cannot be had now.

        """
        model = config.model
        if self._node.state not in ('inactive', 'active') or model == self._model:
            return False    # a node that is configured later loads it then
        if self._worker.busy:
            raise InputError('a bone is being loaded; wait until ~/status no longer says so')
        if not model.path:
            if self._model.path:
                raise InputError('a bone is in use, and points may be registered to it; call the '
                                 'transitions deactivate and cleanup to have none')
            return False
        if not find_model(model.path).is_file():
            raise InputError(f'{model.path}: there is no such file; the bone in use is kept')
        return True

    def begin(self) -> None:
        """Load the bone that the node's settings name."""
        executor = self._node.executor
        assert executor is not None     # it brought the request
        self.notice = f'{self._node.config.model.path} is being loaded; the bone in use is kept ' \
                      'until then'
        executor.create_task(self._exchange)

    def idle(self) -> bool:
        """Take no further bone; tell whether none is being loaded."""
        return self._worker.shutdown(0.0)

    async def _exchange(self) -> None:
        node, config = self._node, self._node.config
        assert node.executor is not None
        try:
            field = await self._worker.run(node.executor, lambda: load(config, node.get_logger()))
        except InputError as error:
            self._keep(error)
        # noqa: BLE001 - a fault of ours must not cost the points
        except Exception as error:
            traceback.print_exc()
            self._keep(InputError(f'{config.model.path}: internal error, please report it: '
                                  f'{type(error).__name__}: {error}'))
        else:
            # a node that was cleaned up meanwhile reads its settings when it is configured again
            if field is not None and node.state in ('inactive', 'active'):
                self.use(config.model)
                node.take_bone(field)
        node.show()

    def _keep(self, error: InputError) -> None:
        """Say that the bone in use stays, and have the parameters say so too."""
        node = self._node
        hint = ('; if the file is in another unit, set model.path and model.unit in one request'
                if error.reason is Reason.WRONG_UNIT else '')
        notice = f'{error.message}{hint}; the bone in use is kept'
        node.get_logger().error(notice)
        if node.state in ('inactive', 'active'):
            node.set_parameters_atomically([
                Parameter(f'model.{name}', value=value)
                for name, value in dataclasses.asdict(self._model).items()])
            self.notice = notice
