# SPDX-License-Identifier: Apache-2.0
"""Landmarks: named places on the bone model, and where they were found in the tracker frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from gsdf_registration.common.result import InputError, as_numbers
from gsdf_registration.common.rigid import MAX_COORDINATE, Array


@dataclass(frozen=True, eq=False)
class Landmarks:
    """
    Touched landmarks and joint centres.

    names : (k,) str
    model : (k, 3) float, m, bone frame
    touched : (k, 3) float, m, tracker frame
    sigmas : (k,) float, m, standard deviation of a landmark along each axis; 0: it is not known, so
        the landmark gives only an initial guess
    """

    names: tuple[str, ...]
    model: Array
    touched: Array
    sigmas: Array

    @classmethod
    def of(cls, model: ArrayLike, touched: ArrayLike, sigmas: ArrayLike | None = None,
           names: Sequence[str] | None = None) -> Landmarks:
        """
        Return checked landmarks; without ``sigmas`` they give only an initial guess.

        Without ``names`` they are numbered from 1.

        Raises
        ------
        InputError
            If the shapes differ, a number is not finite, or a standard deviation is negative.

        """
        model, touched = as_numbers(model, 'model landmarks'), as_numbers(
            touched, 'touched landmarks')
        if model.shape != touched.shape or model.ndim != 2 or model.shape[1] != 3:
            raise InputError(
                'landmarks need one touched point for each model point; the arrays have the shapes '
                f'{model.shape} and {touched.shape}')
        count = len(model)
        sigmas = np.zeros(count) if sigmas is None else as_numbers(
            sigmas, 'standard deviations of landmarks')
        if sigmas.shape != (count,):
            raise InputError(f'landmarks need one standard deviation each: {count} numbers, not '
                             f'an array of the shape {sigmas.shape}')
        if not (np.abs(model) < MAX_COORDINATE).all() or not (
                np.abs(touched) < MAX_COORDINATE).all():
            raise InputError('a landmark has a coordinate that is not finite; touch it again')
        if not (sigmas >= 0.0).all() or not np.isfinite(sigmas).all():
            raise InputError('the standard deviation of a landmark must be 0 (not known) or a '
                             'positive number in metres')
        names = [str(k + 1) for k in range(count)] if names is None else names
        if len(names) != count:
            raise InputError(f'{count} landmarks have {len(names)} names; give each its own')
        return cls(tuple(names), model, touched, sigmas)

    def __len__(self) -> int:
        """Return the number of landmarks."""
        return len(self.names)

    def equals(self, other: Landmarks) -> bool:
        """Return whether these are the same landmarks, touched at the same places."""
        return self.names == other.names and all(
            np.array_equal(mine, theirs) for mine, theirs in (
                (self.model, other.model), (self.touched, other.touched),
                (self.sigmas, other.sigmas)))

    @property
    def measured(self) -> Landmarks:
        """Those with a standard deviation: measurements of the pose."""
        return self.rows(np.flatnonzero(self.sigmas > 0.0).tolist())

    def rows(self, rows: Sequence[int]) -> Landmarks:
        """Return some of the landmarks."""
        chosen = list(rows)
        return Landmarks(tuple(self.names[row] for row in chosen), self.model[chosen],
                         self.touched[chosen], self.sigmas[chosen])


NO_LANDMARKS = Landmarks((), np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0))
