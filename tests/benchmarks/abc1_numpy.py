#!/usr/bin/env python3
"""Simulation Set ABC1 in NumPy: the yardstick of montecarlo_benchmark.

Evaluates the rotation experiments as they stand (Rodrigues' formula for each of the nine sensitivity vectors at each of
the 216 angles; Geist & Gaitan 2021, Eqs. 11 to 13, and the tilt of the platter with Z), then the ABC fit and the
intrinsic properties. Batched over trials: every NumPy operation works on all trials of a batch at once.

    abc1_numpy.py [TRIALS] [BATCH]      prints one JSON object: trials, seconds of processor time, standard deviations of the errors
"""
import json
import os
import sys
import time

os.environ.setdefault("OMP_NUM_THREADS", "1")  # one core, as the program it is compared with
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
import numpy as np  # noqa: E402  (after the number of threads is set)

N = 72
ALPHA = np.radians(5.0 * np.arange(N))
TOLERANCE = np.radians(0.008)
SPREAD = 0.1


def cross(a, b):
    """a x b along the last axis (np.cross spends most of its time elsewhere)."""
    return np.stack((a[..., 1] * b[..., 2] - a[..., 2] * b[..., 1],
                     a[..., 2] * b[..., 0] - a[..., 0] * b[..., 2],
                     a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]), axis=-1)


def rrf(v, e, angle):
    """Rodrigues' rotation formula: v turned about e by angle; everything is broadcast, vectors on the last axis."""
    c, s = np.cos(angle)[..., None], np.sin(angle)[..., None]
    along = np.sum(e * v, axis=-1)[..., None]
    return v * c + cross(e, v) * s + e * along * (1.0 - c)


def intrinsic(s):
    norms = np.linalg.norm(s, axis=-1)
    after = np.roll(s, -1, axis=1)
    phi = np.degrees(np.arctan2(np.linalg.norm(cross(s, after), axis=-1), np.sum(s * after, axis=-1)))
    return norms, phi


def batch(rng, trials):
    s = np.eye(3) + SPREAD * rng.standard_normal((trials, 3, 3))
    offset = SPREAD * rng.standard_normal((trials, 3))
    zx, zy, xz = np.sin(TOLERANCE) * rng.standard_normal((3, trials))
    theta = ALPHA + TOLERANCE * rng.standard_normal((3, trials, N))

    z_axis = np.stack((zx, zy, np.sqrt(1.0 - zx**2 - zy**2)), axis=-1)
    x_axis = np.stack((np.sqrt(1.0 - xz**2), np.zeros(trials), xz), axis=-1)
    e = np.stack((-zy, zx, np.zeros(trials)), axis=-1)
    sine = np.linalg.norm(e, axis=-1)
    tilt = np.arctan2(sine, z_axis[:, 2])
    s = rrf(s, (e / sine[:, None])[:, None, :], np.broadcast_to(tilt[:, None], (trials, 3)))

    # trials x angles x accelerometers x components
    x_all, z_all = x_axis[:, None, None, :], z_axis[:, None, None, :]
    quarter = np.full((trials, 1, 1), -np.pi / 2.0)
    start = s[:, None, :, :]
    angles = theta[..., None]
    r1 = rrf(start, x_all, angles[0])[..., 2] + offset[:, None, :]
    r2 = rrf(rrf(start, z_all, quarter), x_all, angles[1])[..., 2] + offset[:, None, :]
    r3 = rrf(rrf(start, x_all, quarter), rrf(z_all, x_all, quarter), angles[2])[..., 2] + offset[:, None, :]

    sin_a, cos_a = 2.0 / N * np.sin(ALPHA), 2.0 / N * np.cos(ALPHA)
    a = [np.einsum("n,tnj->tj", sin_a, r) for r in (r1, r2, r3)]
    b = [np.einsum("n,tnj->tj", cos_a, r) for r in (r1, r2, r3)]
    c = [r.mean(axis=1) for r in (r1, r2, r3)]
    found = np.stack((-(a[1] + a[2]) / 2.0, (a[0] - b[2]) / 2.0, (b[0] + b[1]) / 2.0), axis=-1)
    found_offset = (c[0] + c[1] + c[2]) / 3.0
    norms, phi = intrinsic(s)
    found_norms, found_phi = intrinsic(found)
    return np.concatenate(((found - s).reshape(trials, 9), found_offset - offset, found_norms - norms,
                           found_phi - phi), axis=1)


def main():
    trials = int(sys.argv[1]) if len(sys.argv) > 1 else 4000
    size = int(sys.argv[2]) if len(sys.argv) > 2 else 200
    rng = np.random.default_rng(1)
    batch(rng, size)  # warm up
    start = time.process_time()
    errors = np.concatenate([batch(rng, size) for _ in range(trials // size)])
    seconds = time.process_time() - start
    print(json.dumps({"trials": len(errors), "seconds": seconds,
                      "standard_deviation": errors.std(axis=0, ddof=1).tolist()}))


if __name__ == "__main__":
    main()
