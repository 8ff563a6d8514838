#!/usr/bin/env python3
"""The Python side of library_benchmark: seconds of processor time of analyses of one CSV.

    joint_python.py FILE.csv COUNT    prints: seconds of COUNT joint analyses, seconds of COUNT ABC fits in NumPy
"""
import os
import sys
import time

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
import numpy as np  # noqa: E402

import abcal  # noqa: E402


def abc_reference(alpha, readings):
    """The published protocol (Geist & Gaitan 2021, Eqs. 5 to 10): matrix and offset of readings (3, N, 3)."""
    design = np.stack([np.sin(alpha), np.cos(alpha), np.ones_like(alpha)], axis=1)
    (a1, b1, c1), (a2, b2, c2), (a3, b3, c3) = (np.linalg.lstsq(design, r, rcond=None)[0] for r in readings)
    x = np.stack([-a2, -a3])
    y = np.stack([a1, -b3])
    z = np.stack([b1, b2])
    return np.stack([x.mean(axis=0), y.mean(axis=0), z.mean(axis=0)], axis=1), np.mean([c1, c2, c3], axis=0)


def main():
    record = abcal.load(sys.argv[1])
    count = int(sys.argv[2])
    use = ~np.array(record.closing)
    alpha = np.radians(record.alpha_deg[use].reshape(3, -1)[0])
    readings = record.readings[use].reshape(3, -1, 3)
    begin = time.process_time()
    for _ in range(count):
        abcal.analyse(record, "joint").sensitivity_matrix.value
    joint = time.process_time() - begin
    begin = time.process_time()
    for _ in range(count):
        matrix, offset = abc_reference(alpha, readings)
    reference = time.process_time() - begin
    expected = abcal.analyse(record, "abc")
    if not np.abs(matrix - expected.sensitivity_matrix.value).max() < 1e-4:
        sys.exit(f"the NumPy reference differs from abc:\n{matrix}\n{expected.sensitivity_matrix.value}")
    print(joint, reference)


if __name__ == "__main__":
    main()
