#!/usr/bin/env python3
"""The rod beside scipy's collocation solver: same poses, same start, same accuracy.

Usage: tests/peers/.venv/bin/python tests/peers/rod_peers.py --binary PATH [--json OUT]
Set-up: python3 -m venv tests/peers/.venv && tests/peers/.venv/bin/pip install numpy scipy

Poses, moments and times of the rod come from the built example `peer_poses` (calib/rod/examples). The peer is
scipy.integrate.solve_bvp on the same boundary value problem: straight part and arc as two stacked segments (so that the jump of the
rest curvature sits on a mesh border), 14 states (quaternion, position twice), four unknown parameters (force, contact arc length).
It starts, like the rod, from the pose 0.3 mm before. Its tolerance is the loosest power of ten whose moment is as close to the rod's
own fine-mesh moment as the rod's working mesh is; where none reaches that, the tightest one tried is timed and said so.
Prints a table, and rows in the peers.json format. Exit 1 where a moment differs by more than 1e-6 of its size.
"""

import argparse
import json
import pathlib
import subprocess
import sys
import time

import numpy as np
import scipy
from scipy.integrate import solve_bvp

ROOT = pathlib.Path(__file__).resolve().parents[2]
TOLERANCES = [1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9]
AGREEMENT = 1e-6


def axes_of(q):
    """Columns of the rotation matrix of a quaternion (w, x, y, z), shape (4, n)."""
    w, x, y, z = q
    t = np.array([w * w + x * x - y * y - z * z, 2 * (x * y + w * z), 2 * (x * z - w * y)])
    n = np.array([2 * (x * y - w * z), w * w - x * x + y * y - z * z, 2 * (y * z + w * x)])
    b = np.array([2 * (x * z + w * y), 2 * (y * z - w * x), w * w - x * x - y * y + z * z])
    return t, n, b


class Peer:
    """The boundary value problem of one wire; lengths in mm, forces in N."""

    def __init__(self, wire):
        self.wire = wire
        self.stiffness = np.array([wire["gj_nmm2"], wire["ei_nmm2"], wire["ei_nmm2"]])
        self.mesh = np.linspace(0, 1, 16)

    def segment(self, y, force, point, rest, length):
        q, r = y[:4], y[4:]
        axes = axes_of(q)
        moment = np.cross((point[:, None] - r).T, force).T
        u = [np.sum(a * moment, axis=0) / d for a, d in zip(axes, self.stiffness)]
        u[1] = u[1] + rest
        w, x, yy, z = q
        dq = 0.5 * np.array([
            -x * u[0] - yy * u[1] - z * u[2],
            w * u[0] + yy * u[2] - z * u[1],
            w * u[1] - x * u[2] + z * u[0],
            w * u[2] + x * u[1] - yy * u[0],
        ])
        return np.vstack([dq, axes[0]]) * length

    def solve(self, point, start, tolerance):
        straight, radius = self.wire["straight_mm"], self.wire["radius_mm"]
        point = np.asarray(point)
        # Parameters of the size of one: forces in units of EI / s^2.
        scale = self.wire["ei_nmm2"] / straight**2

        def slope(_t, y, p):
            force = p[:3] * scale
            return np.vstack([
                self.segment(y[:7], force, point, 0.0, straight),
                self.segment(y[7:], force, point, 1.0 / radius, p[3] * straight - straight),
            ])

        def border(a, b, p):
            tangent = axes_of(b[7:11, None])[0][:, 0]
            return np.concatenate([
                a[:4] - [1.0, 0.0, 0.0, 0.0],
                a[4:7],
                a[7:] - b[:7],
                b[11:] - point,
                [p[:3] @ tangent],
            ])

        x, y, p = start
        found = solve_bvp(slope, border, x, y, p=p, tol=tolerance, max_nodes=20000)
        return found, np.cross(point, found.p[:3] * scale)

    def begin(self, pose):
        """The neighbour pose, solved tightly from the rod's force: both solvers start there."""
        straight = self.wire["straight_mm"]
        scale = self.wire["ei_nmm2"] / straight**2
        p = np.append(np.array(pose["neighbour_force_n"]) / scale, pose["neighbour_arclength_mm"] / straight)
        force, point = p[:3] * scale, np.array(pose["neighbour_point_mm"])
        # Initial states by integrating from the clamp.
        y = np.zeros((14, self.mesh.size))
        state = np.array([1.0, 0, 0, 0, 0, 0, 0])
        for rows, rest, length in ((slice(0, 7), 0.0, straight), (slice(7, 14), 1 / self.wire["radius_mm"], p[3] * straight - straight)):
            for k in range(self.mesh.size):
                y[rows, k] = state
                for _ in range(20 if k + 1 < self.mesh.size else 0):
                    h = (self.mesh[1] - self.mesh[0]) / 20
                    middle = state + 0.5 * h * self.segment(state[:, None], force, point, rest, length)[:, 0]
                    state = state + h * self.segment(middle[:, None], force, point, rest, length)[:, 0]
        return self.mesh, y, p


def timed(action, repeats=7):
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        action()
        times.append(time.perf_counter() - start)
    return 1e6 * sorted(times)[repeats // 2]


def main():
    arguments = argparse.ArgumentParser(description="the rod beside scipy.integrate.solve_bvp")
    arguments.add_argument("--json", type=pathlib.Path, help="write rows in the peers.json format here")
    arguments.add_argument("--binary", type=pathlib.Path, required=True, help="the built example peer_poses")
    options = arguments.parse_args()
    wire = json.loads(subprocess.run([options.binary], cwd=ROOT, check=True, capture_output=True).stdout)
    peer, rows, agree = Peer(wire), [], True
    print(f"{'pose':>4} {'rod us':>8} {'rod err':>9} {'scipy us':>10} {'tol':>7} {'scipy err':>9} {'ratio':>8} {'differ':>9}")
    for number, pose in enumerate(wire["poses"], 1):
        fine, ours = np.array(pose["fine_moment_nmm"]), np.array(pose["moment_nmm"])
        size = np.linalg.norm(fine)
        our_error = np.linalg.norm(ours - fine) / size
        start = peer.begin(pose)
        tight, tight_moment = peer.solve(pose["point_mm"], start, 1e-10)
        differ = np.linalg.norm(ours - tight_moment) / size
        agree &= tight.success and differ < AGREEMENT
        for tolerance in TOLERANCES:
            found, moment = peer.solve(pose["point_mm"], start, tolerance)
            their_error = np.linalg.norm(moment - fine) / size
            if found.success and their_error <= our_error:
                break
        micro = timed(lambda: peer.solve(pose["point_mm"], start, tolerance))
        ratio = micro / pose["microseconds"]
        print(f"{number:>4} {pose['microseconds']:>8.1f} {our_error:>9.1e} {micro:>10.0f} {tolerance:>7.0e} {their_error:>9.1e} {ratio:>8.0f} {differ:>9.1e}")
        rows.append({
            "what": f"one rod solve from the pose 0.3 mm before, pose {number}",
            "peer": f"scipy {scipy.__version__} solve_bvp",
            "ours": pose["microseconds"],
            "theirs": round(micro, 1),
            "unit": "us",
            "ratio": round(ratio, 1),
            "goal": "50-200 us at the working mesh, moments within 1e-6",
            "met": bool(pose["microseconds"] <= 200 and differ < AGREEMENT),
            "note": f"relative moment error: rod {our_error:.1e}, scipy {their_error:.1e} at tol {tolerance:.0e}; moments differ by {differ:.1e}",
        })
    if options.json:
        options.json.write_text(json.dumps({"rows": rows}, indent=1) + "\n")
    if not agree:
        print("moments differ by more than 1e-6", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
