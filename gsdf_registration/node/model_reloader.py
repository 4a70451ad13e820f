# SPDX-License-Identifier: Apache-2.0
"""Another bone for a running node: loaded beside the executor, taken when it is whole."""

from __future__ import annotations

import dataclasses
import traceback
from typing import TYPE_CHECKING, Any

from rclpy.parameter import Parameter

from gsdf_registration.common.config import Config, ModelConfig, settings
from gsdf_registration.common.result import InputError, Reason
from gsdf_registration.field.model import find_model
from gsdf_registration.node.loading import load
from gsdf_registration.node.parameters import parameter_type
from gsdf_registration.node.worker import Worker

if TYPE_CHECKING:
    from gsdf_registration.node.node import RegistrationNode


class ModelReloader:
    """
    Loads the bone that ``model.*`` name from now on.

    Until it is there, and if it cannot be had, the old one stays; the points stay in any case.
    What is named on a bone, landmarks and targets, is not on another: it is replaced by what the
    request names, or dropped.
    """

    def __init__(self, node: RegistrationNode) -> None:
        self.notice = ''        # one sentence while a bone is loaded
        self._node = node
        self._worker = Worker()
        self._model = ModelConfig()     # of the bone in use
        self._given: dict[str, list[Any]] = {}      # what the request names, old and new

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
        if self._node.state not in ('inactive', 'active'):
            return False    # a node that is configured later loads it then
        other = model != self._model
        if self._worker.busy and (other or _named(config) != _named(self._node.config)):
            raise InputError('a bone is being loaded; wait until ~/status no longer says so')
        if not other:
            return False
        if not model.path:
            if self._model.path:
                raise InputError('a bone is in use, and points may be registered to it; call the '
                                 'transitions deactivate and cleanup to have none')
            return False
        if not find_model(model.path).is_file():
            raise InputError(f'{model.path}: there is no such file; the bone in use is kept')
        return True

    def until_then(self, config: Config) -> Config:
        """Return ``config`` with what is named on the bone in use, and keep what it names."""
        self._given = _named(config)
        return config.replaced(_named(self._node.config)) if self._model.path else config

    def begin(self) -> None:
        """Load the bone that the node's settings name."""
        executor = self._node.executor
        assert executor is not None     # it brought the request
        self.notice = f'{self._node.config.model.path} is being loaded; the bone in use is kept ' \
                      'until then'
        self._node.session.remark('')   # on a bone that could not be had
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
                self._model = config.model
                if node.take_bone(field):
                    self._name_anew()
                else:
                    self._set(self._given)
                self.notice = ''
        node.show()

    def _name_anew(self) -> None:
        """Go on with what is named on the bone taken, and say so if that is less than before."""
        node, before = self._node, _named(self._node.config)
        coming = _of_another(before, self._given)
        words = f'{node.config.model.path} is in use'
        if any(before[name] and not coming[name] for name in before):
            words += ('; landmarks and targets were those of the bone before and are dropped: name '
                      'them on this one')
            node.get_logger().warning(words)
        self._set(coming)
        node.session.remark(words)

    def _keep(self, error: InputError) -> None:
        """Say that the bone in use stays, and have the parameters say so too."""
        node = self._node
        hint = ('; if the file is in another unit, set model.path and model.unit in one request'
                if error.reason is Reason.WRONG_UNIT else '')
        notice = f'{error.message}{hint}; the bone in use is kept'
        node.get_logger().error(notice)
        if node.state in ('inactive', 'active'):
            self._set({f'model.{name}': value for name, value in
                       dataclasses.asdict(self._model).items()} | _named(node.config))
            self.notice = ''
            node.session.remark(notice)

    def _set(self, values: dict[str, Any]) -> None:
        """Have the parameters say this, as if it had been asked for."""
        known = dict(settings())
        self._node.set_parameters_atomically([
            Parameter(name, parameter_type(known[name]), value) for name, value in values.items()])


def _named(config: Config) -> dict[str, list[Any]]:
    """Return by name the settings that are true of one bone only."""
    flat = config.flat()
    return {name: flat[name] for name in ('landmarks.names', 'landmarks.positions', 'targets.names',
                                          'targets.positions', 'guidance.near')}


def _of_another(before: dict[str, list[Any]], given: dict[str, list[Any]]) -> dict[str, list[Any]]:
    """Return what of ``given`` is named on another bone: what is not as it was ``before``."""
    coming: dict[str, list[Any]] = {name: [] for name in given}
    for section in ('landmarks', 'targets'):
        pair = [f'{section}.names', f'{section}.positions']
        if any(given[name] != before[name] for name in pair):
            coming |= {name: given[name] for name in pair}
    known = coming['landmarks.names'] + coming['targets.names']
    coming['guidance.near'] = [name for name in given['guidance.near'] if name in known]
    return coming
