# SPDX-License-Identifier: Apache-2.0
"""
Registration by Gaussian mixtures.

The Gaussians are on the part of the model near the points; the points are the data. With the roles
exchanged, the untouched part of the bone would be outliers. The initial width is the error of the
start.
"""

from __future__ import annotations

import numpy as np
from icp import Align, Array, Model

MM = 1e3
FIRST = 3.0         # mm, initial standard deviation: the error of the start
OUTLIERS = 0.01     # assumed share of outliers; with more, the fit slides along the surface
MARGIN = 0.02       # m, of the model around the points


def near(model: Model, points: Array, most: int) -> tuple[Array, Array]:
    """Return model points (m, 3) around the points, at most ``most``, and their normals."""
    inside = ((model['points'] > points.min(axis=0) - MARGIN)
              & (model['points'] < points.max(axis=0) + MARGIN)).all(axis=1)
    rows = np.flatnonzero(inside)[:most]
    return model['points'][rows], model['normals'][rows]


def about(centroid: Array, R: Array, t: Array) -> Array:
    """Return the transform (4, 4), m, of x -> R x + t with x in mm from ``centroid``."""
    motion = np.eye(4)
    motion[:3, :3] = R
    motion[:3, 3] = centroid + t.ravel() / MM - R @ centroid
    return motion


def pycpd_rigid(model: Model) -> Align:
    """pycpd: without scale; few points, because each step considers every pair."""
    from pycpd import RigidRegistration

    class Rigid(RigidRegistration):
        """Without the scale that pycpd always estimates (Myronenko and Song 2010, figure 2)."""

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
        centroid = points.mean(axis=0)
        fit = Rigid(X=MM * (points[::2] - centroid), Y=MM * (gaussians - centroid), sigma2=FIRST**2,
                    w=OUTLIERS, max_iterations=150, tolerance=1e-3)
        fit.register()
        # x = y R + t (row vectors) moves the model to the points: return the inverse
        return about(centroid, fit.R, -fit.R @ np.ravel(fit.t))
    return align


def rustcpd_rigid(model: Model) -> Align:
    """rustcpd: the same without the limit on the number of points."""
    import rustcpd

    def align(points: Array, noise: float) -> Array:
        gaussians, _ = near(model, points, 10_000)
        centroid = points.mean(axis=0)
        fit = rustcpd.register_rigid(MM * (points - centroid), MM * (gaussians - centroid),
                                     scale=False, sigma2=FIRST**2, outlier_weight=OUTLIERS,
                                     max_iterations=200, tolerance=1e-5, parallel=False)
        # as above
        return about(centroid, fit.rotation, -fit.rotation @ np.ravel(fit.translation))
    return align


def filterreg_plane(model: Model) -> Align:
    """FilterReg of probreg: point-to-plane; the width is estimated, and at least the noise."""
    from probreg import filterreg
    unit = 100.0        # its lattice needs lengths of a few units

    def align(points: Array, noise: float) -> Array:
        gaussians, normals = near(model, points, 20_000)
        centroid = points.mean(axis=0)
        fit = filterreg.registration_filterreg(
            unit * (points - centroid), unit * (gaussians - centroid), normals,
            sigma2=(unit * FIRST / MM) ** 2, update_sigma2=True, w=0.2,
            objective_type='pt2pl', maxiter=100, tol=1e-6,
            min_sigma2=(unit * max(noise, 7e-4)) ** 2).transformation
        return about(centroid, fit.rot, MM / unit * fit.t)
    return align


def jrmpc_views(model: Model) -> Align:
    """jrmpc: two views; the Gaussians start on the model."""
    from jrmpc.numpy import jrmpc

    def align(points: Array, noise: float) -> Array:
        surface, _ = near(model, points, 1500)
        centroid = points.mean(axis=0)
        views = [MM * (surface - centroid).T, MM * (points[::2] - centroid).T]
        centres = views[0][:, ::4].copy()
        fit = jrmpc(views, X=centres, R=np.stack([np.eye(3)] * 2), t=np.zeros((2, 3)),
                    S=np.full(centres.shape[1], FIRST**2), Q_factor=1.0, max_num_iter=60,
                    gamma=OUTLIERS, epsilon=1e-3)
        model_to, points_to = (about(centroid, R, t) for R, t in zip(fit.R, fit.t))
        return np.linalg.inv(model_to) @ points_to
    return align
