# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Many rigid transforms as numpy arrays: composition, inverse, interpolation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Sequence, Union

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Numbers = Union[Floats, Sequence[float]]
Rows = Union[NDArray[Any], slice]
"""Selection of rows: their indices, or a bool for each row."""

_SMALL_SINE = 1e-6
"""Sine of half the angle between two rotations below which the arc is a straight line in a
double."""


@dataclass(frozen=True)
class Rigid:
    """Many rigid transforms, one per row. For poses: from the object to its parent frame.

    ``a @ b`` applies first b and then a, row by row; a single row is used for all rows of the
    other.
    """

    moved: Floats
    """Translations, (n, 3): x, y, z, metres."""
    turned: Floats
    """Rotations, (n, 4): unit quaternions x, y, z, w."""

    @classmethod
    def none(cls, count: int) -> Rigid:
        """Return ``count`` identity transforms."""
        turned = np.zeros((count, 4))
        turned[:, 3] = 1
        return cls(np.zeros((count, 3)), turned)

    @classmethod
    def planar(cls, x: Numbers, y: Numbers, yaw: Numbers) -> Rigid:
        """Return poses in the plane: x and y in metres, yaw in radians counterclockwise."""
        half = np.asarray(yaw, np.float64) / 2
        none = np.zeros_like(half)
        moved = np.stack([np.asarray(x, np.float64), np.asarray(y, np.float64), none], 1)
        return cls(moved, np.stack([none, none, np.sin(half), np.cos(half)], 1))

    @classmethod
    def of_numbers(cls, numbers: Floats) -> Rigid:
        """Return the transforms of (n, 7) numbers, x y z and x y z w; rotations are normalised."""
        turned = numbers[:, 3:]
        return cls(numbers[:, :3], turned / np.linalg.norm(turned, axis=1, keepdims=True))

    def __len__(self) -> int:
        return len(self.moved)

    def take(self, rows: Rows) -> Rigid:
        """Return some rows."""
        return Rigid(self.moved[rows], self.turned[rows])

    def put(self, rows: Rows, others: Rigid) -> None:
        """Replace some rows by ``others``, in order."""
        self.moved[rows], self.turned[rows] = others.moved, others.turned

    def __matmul__(self, inner: Rigid) -> Rigid:
        moved = rotated(self.turned, inner.moved) + self.moved
        return Rigid(moved, _product(self.turned, inner.turned))

    def inverse(self) -> Rigid:
        """Return the inverse transforms."""
        back = self.turned * (-1.0, -1.0, -1.0, 1.0)
        return Rigid(-rotated(back, self.moved), back)

    def apply(self, points: Floats) -> Floats:
        """Transform points: (n, 3), one per transform, or (m, 3) by a single transform."""
        return rotated(self.turned, points) + self.moved

    @property
    def x(self) -> Floats:
        """x, metres."""
        return self.moved[:, 0]

    @property
    def y(self) -> Floats:
        """y, metres."""
        return self.moved[:, 1]

    @property
    def yaw(self) -> Floats:
        """Rotation about z, radians in [-pi, pi]."""
        x, y, z, w = self.turned.T
        angles: Floats = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
        return angles


def rotated(turned: Floats, points: Floats) -> Floats:
    """Rotate points by quaternions, row by row; a single row is used for all rows of the other."""
    new_points: Floats
    if len(turned) == 1:
        new_points = points @ _matrices(turned)[0].T
    else:
        new_points = np.einsum("nij,nj->ni", _matrices(turned), points)
    return new_points


def _matrices(turned: Floats) -> Floats:
    """Return the (n, 3, 3) matrices of unit quaternions."""
    x, y, z, w = turned.T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    matrices: Floats = np.moveaxis(np.array(rows), 2, 0)
    return matrices


def _product(a: Floats, b: Floats) -> Floats:
    """Multiply quaternions row by row."""
    real = a[:, 3:] * b[:, 3:] - (a[:, :3] * b[:, :3]).sum(1, keepdims=True)
    axis = a[:, 3:] * b[:, :3] + b[:, 3:] * a[:, :3] + np.cross(a[:, :3], b[:, :3])
    return np.concatenate([axis, real], 1)


def between(a: Rigid, b: Rigid, share: Floats) -> Rigid:
    """Interpolate as tf2 does: linearly, and along the shorter arc; share is 0 at a, 1 at b."""
    weight = share[:, None]
    moved = a.moved + weight * (b.moved - a.moved)
    cosine = (a.turned * b.turned).sum(1, keepdims=True)
    other = np.where(cosine < 0, -b.turned, b.turned)
    angle = np.arccos(np.clip(np.abs(cosine), 0, 1))
    sine = np.sin(angle)
    straight = sine < _SMALL_SINE
    divisor = np.where(straight, 1, sine)
    mine = np.where(straight, 1 - weight, np.sin((1 - weight) * angle) / divisor)
    others = np.where(straight, weight, np.sin(weight * angle) / divisor)
    turned = mine * a.turned + others * other
    return Rigid(moved, turned / np.linalg.norm(turned, axis=1, keepdims=True))
