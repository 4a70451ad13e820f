# SPDX-License-Identifier: Apache-2.0
"""Replaces the bone model of a running node: loads it in the background, then switches."""

from __future__ import annotations

import dataclasses
import traceback
from collections.abc import Callable
from typing import Any, Protocol

from rcl_interfaces.msg import SetParametersResult
from rclpy.executors import Executor
from rclpy.impl.rcutils_logger import RcutilsLogger
from rclpy.parameter import Parameter

from gsdf_registration.common.config import PLACES, Config, ModelConfig, settings
from gsdf_registration.common.result import InputError, Reason
from gsdf_registration.field import Field
from gsdf_registration.field.model import find_model
from gsdf_registration.node.background import BackgroundThread, Result
from gsdf_registration.node.loading import load
from gsdf_registration.node.parameters import parameter_type
from gsdf_registration.session import Session


class ModelNode(Protocol):
    """The node, as far as the model reloader uses it."""

    session: Session

    @property
    def executor(self) -> Executor | None:
        """The executor that spins the node."""

    @property
    def state(self) -> str:
        """Lifecycle state."""

    def get_logger(self) -> RcutilsLogger:
        """Return the logger of the node."""

    def set_parameters_atomically(self, parameters: list[Parameter]) -> SetParametersResult:
        """Set all parameters or none."""

    def use_model(self, field: Field) -> bool:
        """Use this bone; return whether it replaces a different one."""

    def publish_status(self) -> None:
        """Publish ``~/status`` if it has changed."""


class ModelReloader:
    """
    Loads the bone that the parameters ``model.*`` name.

    Until it is loaded, and if it cannot be loaded, the current bone stays in use; the points stay
    in any case. Landmarks and targets on the current bone do not apply to another: they are
    replaced by those in the request, or dropped.
    """

    def __init__(self, node: ModelNode) -> None:
        self.notice = ''        # one sentence while a bone is loaded
        self._node = node
        self._background = BackgroundThread()
        self._model = ModelConfig()     # of the bone in use
        self._requested: dict[str, Any] = {}        # PLACES in the request, changed or not

    def set_current(self, model: ModelConfig) -> None:
        """Set the settings of the bone in use."""
        self._model, self.notice = model, ''

    def reload_needed(self, config: Config) -> bool:
        """
        Return whether ``config`` names another bone than the one in use.

        Raises
        ------
        InputError
            If it cannot be loaded now.

        """
        model = config.model
        if not self._configured():
            return False    # it is loaded when the node is configured
        # the expected error of the surface is no property of the field
        other = dataclasses.replace(model, surface_error=self._model.surface_error) != self._model
        if self._background.busy and (other or _places(config) != _places(self._config)):
            raise InputError('a bone is being loaded; wait until ~/status reports the end')
        if not other:
            return False
        if not model.path:
            if self._model.path:
                raise InputError('model.path is empty, but a bone is in use, and points may be '
                                 'registered to it; to unload it, call the transitions deactivate '
                                 'and cleanup')
            return False
        try:
            find_model(model.path)
        except InputError as error:
            raise InputError(f'{error.message}; the current bone is kept') from None
        return True

    def keep_places(self, config: Config) -> Config:
        """Return ``config`` with the landmarks and targets of the current bone until it changes."""
        self._requested = _places(config)
        return config.replaced(_places(self._config)) if self._model.path else config

    def start(self) -> None:
        """Load the bone that the node's settings name."""
        executor = self._node.executor
        assert executor is not None     # it runs the parameter callback
        self.notice = f'loading {self._config.model.path}; the current bone is used until then'
        self._node.session.set_notice('')   # on a bone that could not be loaded
        executor.create_task(self._reload)

    async def run(self, job: Callable[[], Result]) -> Result:
        """Return what ``job`` returns; it runs on the thread that loads bones."""
        executor = self._node.executor
        assert executor is not None     # it runs the caller
        return await self._background.run(executor, job)

    def shutdown(self) -> bool:
        """Load no more bones; return whether none is being loaded."""
        return self._background.shutdown(0.0)

    @property
    def _config(self) -> Config:
        return self._node.session.config

    def _configured(self) -> bool:
        return self._node.state in ('inactive', 'active')

    async def _reload(self) -> None:
        node, config = self._node, self._config
        assert node.executor is not None
        try:
            field = await self._background.run(
                node.executor, lambda: load(config, node.get_logger(), self._show_progress))
        except InputError as error:
            self._keep_current(error)
        # noqa: BLE001 - an internal error must not lose the points
        except Exception as error:
            traceback.print_exc()
            self._keep_current(InputError(
                f'{config.model.path}: internal error, please report it: '
                f'{type(error).__name__}: {error}'))
        else:
            # a node that was cleaned up meanwhile loads its bone when it is configured again
            if field is not None and self._configured():
                self._model = config.model
                if node.use_model(field):
                    self._replace_places()
                else:
                    self._set_parameters(self._requested)
                self.notice = ''
        node.publish_status()

    def _show_progress(self, _: float, sentence: str) -> None:
        """Show what is done; called in the background."""
        self.notice = f'{sentence}; the current bone is used until then'

    def _replace_places(self) -> None:
        """Use the landmarks and targets of the new bone, and report it if any were dropped."""
        node, before = self._node, _places(self._config)
        after = _places_on_new_bone(before, self._requested)
        notice = f'{self._config.model.path} is in use'
        if any(before[name] and not after[name] for name in before):
            notice += ('; the landmarks and targets of the previous bone are dropped: set those of '
                       'this one')
            node.get_logger().warning(notice)
        self._set_parameters(after)
        node.session.set_notice(notice)

    def _keep_current(self, error: InputError) -> None:
        """Report that the current bone is kept, and set the parameters back to it."""
        node = self._node
        hint = ('; if the file is in another unit, set model.path and model.unit in one request'
                if error.reason is Reason.WRONG_UNIT else '')
        notice = f'{error.message}{hint}; the current bone is kept'
        node.get_logger().error(notice)
        if self._configured():
            model = dataclasses.asdict(self._model)
            self._set_parameters({f'model.{name}': value for name, value in model.items()}
                                 | _places(self._config))
            self.notice = ''
            node.session.set_notice(notice)

    def _set_parameters(self, values: dict[str, Any]) -> None:
        known = dict(settings())
        self._node.set_parameters_atomically([
            Parameter(name, parameter_type(known[name]), value) for name, value in values.items()])


def _places(config: Config) -> dict[str, Any]:
    """Return the settings that refer to places on one bone."""
    flat = config.flat()
    return {name: flat[name] for name in PLACES}


def _places_on_new_bone(before: dict[str, Any], requested: dict[str, Any]) -> dict[str, Any]:
    """Return the requested places on the new bone: those that differ from ``before``."""
    after: dict[str, Any] = {name: [] for name in requested}
    for section in ('landmarks', 'targets'):
        pair = [f'{section}.names', f'{section}.positions']
        if any(requested[name] != before[name] for name in pair):
            after |= {name: requested[name] for name in pair}
    known = after['landmarks.names'] + after['targets.names']
    after['guidance.near'] = [name for name in requested['guidance.near'] if name in known]
    return after
