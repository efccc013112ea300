"""Newton-Euler mechanics of the arm on a moving base, link by link.

Standard Denavit-Hartenberg frames at the far ends of the links; body 0 is the base link in
the platform-top frame. Everything in the frame of the body it belongs to (Luh, Walker, Paul,
J. Dyn. Sys. Meas. Control 102, 1980). Frictionless and rigid: gears and friction are in
`plant.py`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ves_gym._util.params import Array
from ves_gym.diagnosis.benchmark.blind.compiled import compiled

GRAVITY = 9.81  # m/s^2


class BodyParameters(NamedTuple):
    """Geometry and mass of base link (row 0) and links."""

    dh: Array  # (n, 4) d [m], a [m], alpha [rad], offset [rad]
    mass: Array  # (n + 1,) kg
    com: Array  # (n + 1, 3) m
    inertia: Array  # (n + 1, 3, 3) kg m^2 about the centre of mass


@compiled
def turn_in(c, s, ca, sa, x, y, z):  # type: ignore[no-untyped-def]
    """Return a vector of the frame before, in the link's frame."""
    u = c * x + s * y
    w = -s * x + c * y
    return u, ca * w + sa * z, -sa * w + ca * z


@compiled
def turn_out(c, s, ca, sa, x, y, z):  # type: ignore[no-untyped-def]
    """Return a vector of the link's frame, in the frame before."""
    w = ca * y - sa * z
    return c * x - s * w, s * x + c * w, sa * y + ca * z


@compiled
def body_force(m, r, inertia, wx, wy, wz, bx, by, bz, ax, ay, az):  # type: ignore[no-untyped-def]
    """Return force at, and moment about, the centre of mass: m a_c and I b + w x I w."""
    x, y, z = r[0], r[1], r[2]
    # b x r + w x (w x r)
    dot = wx * x + wy * y + wz * z
    square = wx * wx + wy * wy + wz * wz
    fx = m * (ax + by * z - bz * y + wx * dot - square * x)
    fy = m * (ay + bz * x - bx * z + wy * dot - square * y)
    fz = m * (az + bx * y - by * x + wz * dot - square * z)
    hx = inertia[0, 0] * wx + inertia[0, 1] * wy + inertia[0, 2] * wz
    hy = inertia[1, 0] * wx + inertia[1, 1] * wy + inertia[1, 2] * wz
    hz = inertia[2, 0] * wx + inertia[2, 1] * wy + inertia[2, 2] * wz
    nx = inertia[0, 0] * bx + inertia[0, 1] * by + inertia[0, 2] * bz + wy * hz - wz * hy
    ny = inertia[1, 0] * bx + inertia[1, 1] * by + inertia[1, 2] * bz + wz * hx - wx * hz
    nz = inertia[2, 0] * bx + inertia[2, 1] * by + inertia[2, 2] * bz + wx * hy - wy * hx
    return fx, fy, fz, nx, ny, nz


@compiled
def fill_trig(bodies, q, trig):  # type: ignore[no-untyped-def]
    """Fill cos, sin of the joint angles and of the twists.

    Args:
        bodies: geometry.
        q: (n,) rad.
        trig: (n, 4) output.
    """
    for i in range(len(q)):
        angle, alpha = q[i] + bodies.dh[i, 3], bodies.dh[i, 2]
        trig[i, 0], trig[i, 1] = math.cos(angle), math.sin(angle)
        trig[i, 2], trig[i, 3] = math.cos(alpha), math.sin(alpha)


@compiled
def newton_euler(bodies, trig, v, a, spin, turn, pull, work, tau, wrench):  # type: ignore[no-untyped-def]
    """Compute joint torques (n,) and the wrench (6,) of the arm on the platform at its origin.

    Args:
        bodies: geometry and mass.
        trig: (n, 4) of the joint angles, see `fill_trig`.
        v, a: (n,) joint rates and accelerations.
        spin, turn: (3,) angular velocity and acceleration of the platform, its own axes.
        pull: (3,) acceleration of its origin less free fall, its own axes.
        work: (n + 1, 12) scratch.
        tau, wrench: outputs.
    """
    n = len(v)
    wx, wy, wz = spin[0], spin[1], spin[2]
    bx, by, bz = turn[0], turn[1], turn[2]
    ax, ay, az = pull[0], pull[1], pull[2]
    for i in range(n + 1):
        if i > 0:
            d, reach = bodies.dh[i - 1, 0], bodies.dh[i - 1, 1]
            c, s, ca, sa = trig[i - 1, 0], trig[i - 1, 1], trig[i - 1, 2], trig[i - 1, 3]
            rate = v[i - 1]
            # z x-terms of a joint that turns about z of the frame before
            bx, by, bz = bx + wy * rate, by - wx * rate, bz + a[i - 1]
            wz += rate
            wx, wy, wz = turn_in(c, s, ca, sa, wx, wy, wz)
            bx, by, bz = turn_in(c, s, ca, sa, bx, by, bz)
            ax, ay, az = turn_in(c, s, ca, sa, ax, ay, az)
            px, py, pz = reach, d * sa, d * ca
            dot = wx * px + wy * py + wz * pz
            square = wx * wx + wy * wy + wz * wz
            ax += by * pz - bz * py + wx * dot - square * px
            ay += bz * px - bx * pz + wy * dot - square * py
            az += bx * py - by * px + wz * dot - square * pz
            work[i, 6], work[i, 7], work[i, 8] = px, py, pz
        fx, fy, fz, nx, ny, nz = body_force(
            bodies.mass[i],
            bodies.com[i],
            bodies.inertia[i],
            wx, wy, wz, bx, by, bz, ax, ay, az,
        )  # fmt: skip
        work[i, 0], work[i, 1], work[i, 2] = fx, fy, fz
        work[i, 3], work[i, 4], work[i, 5] = nx, ny, nz
    fx = fy = fz = nx = ny = nz = 0.0  # of all beyond, in the present link's frame
    for i in range(n, -1, -1):
        gx, gy, gz = work[i, 0], work[i, 1], work[i, 2]
        px = py = pz = 0.0
        if i > 0:
            px, py, pz = work[i, 6], work[i, 7], work[i, 8]
        rx, ry, rz = px + bodies.com[i, 0], py + bodies.com[i, 1], pz + bodies.com[i, 2]
        nx += work[i, 3] + py * fz - pz * fy + ry * gz - rz * gy
        ny += work[i, 4] + pz * fx - px * fz + rz * gx - rx * gz
        nz += work[i, 5] + px * fy - py * fx + rx * gy - ry * gx
        fx, fy, fz = fx + gx, fy + gy, fz + gz
        if i > 0:
            c, s, ca, sa = trig[i - 1, 0], trig[i - 1, 1], trig[i - 1, 2], trig[i - 1, 3]
            fx, fy, fz = turn_out(c, s, ca, sa, fx, fy, fz)
            nx, ny, nz = turn_out(c, s, ca, sa, nx, ny, nz)
            tau[i - 1] = nz
    wrench[0], wrench[1], wrench[2] = -fx, -fy, -fz
    wrench[3], wrench[4], wrench[5] = -nx, -ny, -nz


@compiled
def unit_column(bodies, trig, j, work, column):  # type: ignore[no-untyped-def]
    """Compute torques (n,) and wrench (6,) that accelerating joint j alone takes, from rest.

    Newton-Euler without velocities; links before the joint stay at rest.

    Args:
        bodies: geometry and mass.
        trig: (n, 4), see `fill_trig`.
        j: joint.
        work: (n + 1, 12) scratch.
        column: (n + 6,) output.
    """
    n = len(trig)
    bx = by = ax = ay = az = 0.0
    bz = 1.0
    for i in range(j + 1, n + 1):
        c, s, ca, sa = trig[i - 1, 0], trig[i - 1, 1], trig[i - 1, 2], trig[i - 1, 3]
        bx, by, bz = turn_in(c, s, ca, sa, bx, by, bz)
        ax, ay, az = turn_in(c, s, ca, sa, ax, ay, az)
        px, py, pz = bodies.dh[i - 1, 1], bodies.dh[i - 1, 0] * sa, bodies.dh[i - 1, 0] * ca
        ax += by * pz - bz * py
        ay += bz * px - bx * pz
        az += bx * py - by * px
        x, y, z, m = bodies.com[i, 0], bodies.com[i, 1], bodies.com[i, 2], bodies.mass[i]
        inertia = bodies.inertia[i]
        work[i, 0] = m * (ax + by * z - bz * y)
        work[i, 1] = m * (ay + bz * x - bx * z)
        work[i, 2] = m * (az + bx * y - by * x)
        work[i, 3] = inertia[0, 0] * bx + inertia[0, 1] * by + inertia[0, 2] * bz
        work[i, 4] = inertia[1, 0] * bx + inertia[1, 1] * by + inertia[1, 2] * bz
        work[i, 5] = inertia[2, 0] * bx + inertia[2, 1] * by + inertia[2, 2] * bz
    fx = fy = fz = nx = ny = nz = 0.0
    for i in range(n, 0, -1):
        c, s, ca, sa = trig[i - 1, 0], trig[i - 1, 1], trig[i - 1, 2], trig[i - 1, 3]
        px, py, pz = bodies.dh[i - 1, 1], bodies.dh[i - 1, 0] * sa, bodies.dh[i - 1, 0] * ca
        nx += py * fz - pz * fy
        ny += pz * fx - px * fz
        nz += px * fy - py * fx
        if i > j:
            gx, gy, gz = work[i, 0], work[i, 1], work[i, 2]
            rx, ry, rz = px + bodies.com[i, 0], py + bodies.com[i, 1], pz + bodies.com[i, 2]
            nx += work[i, 3] + ry * gz - rz * gy
            ny += work[i, 4] + rz * gx - rx * gz
            nz += work[i, 5] + rx * gy - ry * gx
            fx, fy, fz = fx + gx, fy + gy, fz + gz
        fx, fy, fz = turn_out(c, s, ca, sa, fx, fy, fz)
        nx, ny, nz = turn_out(c, s, ca, sa, nx, ny, nz)
        column[i - 1] = nz
    column[n], column[n + 1], column[n + 2] = -fx, -fy, -fz
    column[n + 3], column[n + 4], column[n + 5] = -nx, -ny, -nz


@compiled
def solve3(A, b, x):  # type: ignore[no-untyped-def]
    """Solve A x = b for a symmetric (3, 3) A, by cofactors; x is the output."""
    c00 = A[1, 1] * A[2, 2] - A[1, 2] * A[2, 1]
    c01 = A[1, 2] * A[2, 0] - A[1, 0] * A[2, 2]
    c02 = A[1, 0] * A[2, 1] - A[1, 1] * A[2, 0]
    det = A[0, 0] * c00 + A[0, 1] * c01 + A[0, 2] * c02
    c11 = A[0, 0] * A[2, 2] - A[0, 2] * A[2, 0]
    c12 = A[0, 1] * A[2, 0] - A[0, 0] * A[2, 1]
    c22 = A[0, 0] * A[1, 1] - A[0, 1] * A[1, 0]
    x0 = (c00 * b[0] + c01 * b[1] + c02 * b[2]) / det
    x1 = (c01 * b[0] + c11 * b[1] + c12 * b[2]) / det
    x2 = (c02 * b[0] + c12 * b[1] + c22 * b[2]) / det
    x[0], x[1], x[2] = x0, x1, x2


@compiled
def platform_motion(pose, rate, acc, spin, turn, pull):  # type: ignore[no-untyped-def]
    """Compute the platform's angular motion, and its origin's acceleration less free fall.

    Args:
        pose, rate, acc: (6,) Z-Y-X pose and its derivatives.
        spin, turn, pull: (3,) outputs, platform axes.
    """
    cx, sx = math.cos(pose[3]), math.sin(pose[3])
    cy, sy = math.cos(pose[4]), math.sin(pose[4])
    cz, sz = math.cos(pose[5]), math.sin(pose[5])
    dx, dy, dz = rate[3], rate[4], rate[5]
    ex, ey, ez = acc[3], acc[4], acc[5]
    spin[0] = dx - sy * dz
    spin[1] = cx * dy + sx * cy * dz
    spin[2] = -sx * dy + cx * cy * dz
    turn[0] = ex - sy * ez - cy * dy * dz
    turn[1] = cx * ey + sx * cy * ez - sx * dx * dy + (cx * cy * dx - sx * sy * dy) * dz
    turn[2] = -sx * ey + cx * cy * ez - cx * dx * dy - (sx * cy * dx + cx * sy * dy) * dz
    ux, uy, uz = acc[0], acc[1], acc[2] + GRAVITY
    pull[0] = cz * cy * ux + sz * cy * uy - sy * uz
    pull[1] = (cz * sy * sx - sz * cx) * ux + (sz * sy * sx + cz * cx) * uy + cy * sx * uz
    pull[2] = (cz * sy * cx + sz * sx) * ux + (sz * sy * cx - cz * sx) * uy + cy * cx * uz


@compiled
def conjugate(pose, wrench, force):  # type: ignore[no-untyped-def]
    """Compute the generalised force on the Z-Y-X pose of a wrench in platform axes.

    Args:
        pose, wrench: (6,).
        force: (6,) output.
    """
    cx, sx = math.cos(pose[3]), math.sin(pose[3])
    cy, sy = math.cos(pose[4]), math.sin(pose[4])
    cz, sz = math.cos(pose[5]), math.sin(pose[5])
    a, b, c = wrench[0], wrench[1], wrench[2]
    force[0] = cz * cy * a + (cz * sy * sx - sz * cx) * b + (cz * sy * cx + sz * sx) * c
    force[1] = sz * cy * a + (sz * sy * sx + cz * cx) * b + (sz * sy * cx - cz * sx) * c
    force[2] = -sy * a + cy * sx * b + cy * cx * c
    a, b, c = wrench[3], wrench[4], wrench[5]
    force[3] = a
    force[4] = cx * b - sx * c
    force[5] = -sy * a + cy * sx * b + cy * cx * c


def inverse_dynamics(
    bodies: BodyParameters, rotor: Array, q: Array, v: Array, a: Array
) -> Array:
    """Return motor torques of motions on a base at rest, weight aside.

    Args:
        bodies: geometry and mass.
        rotor: (n,) kg m^2.
        q, v, a: (N, n).

    Returns:
        (N, n) N m.
    """
    out = np.empty_like(q)
    _series(bodies, q, v, a, out)
    return out + rotor * a


@compiled
def _series(bodies, q, v, a, out):  # type: ignore[no-untyped-def]
    zero, wrench = np.zeros(3), np.zeros(6)
    n = q.shape[1]
    work, trig = np.zeros((n + 1, 12)), np.zeros((n, 4))
    for k in range(len(q)):
        fill_trig(bodies, q[k], trig)
        newton_euler(bodies, trig, v[k], a[k], zero, zero, zero, work, out[k], wrench)
