#!/usr/bin/env python3
"""Gives the shared recording `livingroom` the layout of the TUM RGB-D benchmark, for `import tum`.

usage: livingroom_as_tum.py SOURCE TARGET     TARGET is made; pictures are linked, not copied
"""
import math
import os
import sys

RATE = 30  # pictures a second


def quaternion(r):
    """x, y, z, w of a rotation matrix, by its largest component (Shepperd 1978)."""
    squares = [
        1 + r[0][0] - r[1][1] - r[2][2],
        1 - r[0][0] + r[1][1] - r[2][2],
        1 - r[0][0] - r[1][1] + r[2][2],
        1 + r[0][0] + r[1][1] + r[2][2],
    ]
    products = [
        [None, r[1][0] + r[0][1], r[0][2] + r[2][0], r[2][1] - r[1][2]],
        [r[1][0] + r[0][1], None, r[2][1] + r[1][2], r[0][2] - r[2][0]],
        [r[0][2] + r[2][0], r[2][1] + r[1][2], None, r[1][0] - r[0][1]],
        [r[2][1] - r[1][2], r[0][2] - r[2][0], r[1][0] - r[0][1], None],
    ]
    largest = max(range(4), key=lambda i: squares[i])
    root = math.sqrt(squares[largest])
    return [0.5 * root if i == largest else 0.5 * products[largest][i] / root for i in range(4)]


def poses(path):
    """Rows of 'index index frames', each followed by a 4 x 4 matrix."""
    with open(path) as file:
        rows = [[float(word) for word in line.split()] for line in file if line.strip()]
    for start in range(0, len(rows), 5):
        yield rows[start + 1 : start + 4]


def main():
    source, target = (os.path.abspath(path) for path in sys.argv[1:3])
    os.makedirs(target)
    for kind, folder in (("rgb", "image"), ("depth", "depth")):
        os.symlink(os.path.join(source, folder), os.path.join(target, kind))
        names = sorted(os.listdir(os.path.join(source, folder)))
        with open(os.path.join(target, kind + ".txt"), "w") as file:
            for number, name in enumerate(names):
                file.write(f"{number / RATE:.6f} {kind}/{name}\n")
    with open(os.path.join(target, "groundtruth.txt"), "w") as file:
        for number, matrix in enumerate(poses(os.path.join(source, "peer_trajectory.log"))):
            values = [row[3] for row in matrix] + quaternion(matrix)
            file.write(f"{number / RATE:.6f} " + " ".join(f"{v:.9f}" for v in values) + "\n")


if len(sys.argv) != 3:
    sys.exit(__doc__)
main()
