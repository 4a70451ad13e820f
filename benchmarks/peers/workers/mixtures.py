# SPDX-License-Identifier: Apache-2.0
"""
Registration as a fit of Gaussian mixtures.

The touched points are what is to be explained and the model near them carries the Gaussians, or
all of the bone that was not touched would be an outlier.  The first width is that of the start.
"""

from __future__ import annotations

import numpy as np
from icp import Align, Array, Model

MM = 1e3
FIRST = 3.0         # mm, standard deviation: what the start is off
OUTLIERS = 0.01     # share taken for interference; more of it lets the fit slide
MARGIN = 0.02       # m, about the points: so much of the model comes along


def near(model: Model, points: Array, most: int) -> tuple[Array, Array]:
    """Return model points (m, 3) about the points, at most so many, and their normals."""
    inside = ((model['points'] > points.min(axis=0) - MARGIN)
              & (model['points'] < points.max(axis=0) + MARGIN)).all(axis=1)
    rows = np.flatnonzero(inside)[:most]
    return model['points'][rows], model['normals'][rows]


def about(centre: Array, R: Array, t: Array) -> Array:
    """Return the motion (4, 4), m, of x -> R x + t with x in mm from ``centre``."""
    motion = np.eye(4)
    motion[:3, :3] = R
    motion[:3, 3] = centre + t.ravel() / MM - R @ centre
    return motion


def pycpd_rigid(model: Model) -> Align:
    """pycpd: the scale held at one; few points, as every pair counts at every step."""
    from pycpd import RigidRegistration

    class Rigid(RigidRegistration):
        """Without the scale, which pycpd always estimates (Myronenko and Song 2010, figure 2)."""

        def update_transform(self) -> None:
            super().update_transform()
            self.s = 1.0
            mean_x = self.P.sum(axis=0) @ self.X / self.Np
            self.t = mean_x - self.P.sum(axis=1) @ self.Y / self.Np @ self.R

        def update_variance(self) -> None:
            super().update_variance()
            moved = (self.Pt1 @ (self.X_hat**2).sum(axis=1) + self.YPY
                     - 2.0 * np.trace(self.A @ self.R))
            self.sigma2 = max(moved / (self.Np * self.D), 1e-6)

    def align(points: Array, noise: float) -> Array:
        gaussians, _ = near(model, points, 2000)
        centre = points.mean(axis=0)
        fit = Rigid(X=MM * (points[::2] - centre), Y=MM * (gaussians - centre), sigma2=FIRST**2,
                    w=OUTLIERS, max_iterations=150, tolerance=1e-3)
        fit.register()
        # rows: x = y R + t moves the model onto the points; wanted is the inverse
        return about(centre, fit.R, -fit.R @ np.ravel(fit.t))
    return align


def rustcpd_rigid(model: Model) -> Align:
    """rustcpd: the same without the limit on points."""
    import rustcpd

    def align(points: Array, noise: float) -> Array:
        gaussians, _ = near(model, points, 10_000)
        centre = points.mean(axis=0)
        fit = rustcpd.register_rigid(MM * (points - centre), MM * (gaussians - centre), scale=False,
                                     sigma2=FIRST**2, outlier_weight=OUTLIERS,
                                     max_iterations=200, tolerance=1e-5, parallel=False)
        # as above
        return about(centre, fit.rotation, -fit.rotation @ np.ravel(fit.translation))
    return align


def filterreg_plane(model: Model) -> Align:
    """Probreg's FilterReg: point to plane, the width estimated and at least that of the noise."""
    from probreg import filterreg
    unit = 100.0        # its lattice wants lengths of a few units

    def align(points: Array, noise: float) -> Array:
        gaussians, normals = near(model, points, 20_000)
        centre = points.mean(axis=0)
        fit = filterreg.registration_filterreg(
            unit * (points - centre), unit * (gaussians - centre), normals,
            sigma2=(unit * FIRST / MM) ** 2, update_sigma2=True, w=0.2,
            objective_type='pt2pl', maxiter=100, tol=1e-6,
            min_sigma2=(unit * max(noise, 7e-4)) ** 2).transformation
        return about(centre, fit.rot, MM / unit * fit.t)
    return align


def jrmpc_views(model: Model) -> Align:
    """jrmpc: two views, the centres first on the model's."""
    from jrmpc.numpy import jrmpc

    def align(points: Array, noise: float) -> Array:
        surface, _ = near(model, points, 1500)
        centre = points.mean(axis=0)
        views = [MM * (surface - centre).T, MM * (points[::2] - centre).T]
        centres = views[0][:, ::4].copy()
        fit = jrmpc(views, X=centres, R=np.stack([np.eye(3)] * 2), t=np.zeros((2, 3)),
                    S=np.full(centres.shape[1], FIRST**2), Q_factor=1.0, max_num_iter=60,
                    gamma=OUTLIERS, epsilon=1e-3)
        model_to, points_to = (about(centre, R, t) for R, t in zip(fit.R, fit.t))
        return np.linalg.inv(model_to) @ points_to
    return align
