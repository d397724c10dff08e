"""In-plane statics of the measured sweep over the bottle, beside its measured moments: a second computation, without wcal.

    wcal fit-gpr fixtures/whiskerfbg --out map && wcal track fixtures/whiskerfbg_bottle --calibration map/calibration.json --out track.csv
    python3 tests/peers/bottle_statics.py [track.csv ...]

A chain of links with the wire's stiffness and rest shape is pressed without friction against the bottle's outline where the release put it (convex hull of the
mesh's section at the wire's height), along the measured motion:

    E = sum_i w_i (a_i - a_(i-1) - a0_i)^2 / 2 + k sum_i min(d(r_i) - radius, 0)^2 / 2      w_i = E I / h;  w_0 = 2 E I / h;  Newton, step by step

Printed: moment about z at the root, the released one (which is that of readings.csv by the released map), their ratio, and where the wire touches. It tells where
moments, motion and object as placed belong together, and where no calibration of one gain could make them: the ratio steps at the bottle's edges.
Then the distances in this plane from the places of the statics, up to the wire's slip at k = 75, of the released network's contacts and of those in track.csv.
"""

import csv
import math
import pathlib
import struct
import sys

import numpy as np

ROOT = pathlib.Path(__file__).resolve().parents[2]
SESSION, SWEEP = ROOT / "fixtures/whiskerfbg", ROOT / "fixtures/whiskerfbg_bottle"
YOUNGS_MPA, DIAMETER_MM = 75e3, 0.3048
PLACE_MM = np.array([111.76475, 10.7875, -22.46])
LINK_MM, STEP_MM, WALL_N_PER_MM2 = 0.25, 0.4, 50.0
# From the first loaded samples to the slip.
FIRST, LAST = 8, 74
EI = YOUNGS_MPA * math.pi * DIAMETER_MM**4 / 64


def rows(path):
    with open(path, newline="") as file:
        return list(csv.DictReader(file))


def turn_of(a, b, c):
    return (b[0] - a[0]) * (c[1] - b[1]) - (b[1] - a[1]) * (c[0] - b[0])


def outline():
    """Convex hull of the mesh's section at z = 0, counter-clockwise, mm."""
    data = (SWEEP / "object.stl").read_bytes()
    count = struct.unpack("<I", data[80:84])[0]
    facets = np.frombuffer(data[84:84 + 50 * count], dtype=[("n", "<f4", 3), ("v", "<f4", (3, 3)), ("a", "<u2")])["v"].astype(float)
    scale = 1e3 if facets.max() < 1 else 1.0
    points = []
    for t in facets * scale + PLACE_MM:
        for a, b in zip(t, np.roll(t, -1, 0)):
            if a[2] * b[2] < 0:
                points.append(tuple((a + (b - a) * a[2] / (a[2] - b[2]))[:2]))
    hull = []
    for turn in (sorted(set(points)), sorted(set(points), reverse=True)):
        part = []
        for p in turn:
            while len(part) > 1 and turn_of(part[-2], part[-1], p) <= 1e-9:
                part.pop()
            part.append(p)
        hull += part[:-1]
    return np.array(hull)


class Wire:
    def __init__(self):
        shape = np.array([[float(r["x_mm"]), float(r["y_mm"])] for r in rows(SESSION / "rest_shape.csv")])
        way = np.r_[0, np.cumsum(np.linalg.norm(np.diff(shape, axis=0), axis=1))]
        angle = np.unwrap(np.arctan2(*np.diff(shape, axis=0).T[::-1]))
        self.count = round(way[-1] / LINK_MM)
        self.h = way[-1] / self.count
        self.rest = np.interp((np.arange(self.count) + 0.5) * self.h, (way[1:] + way[:-1]) / 2, angle, left=angle[0])
        self.root = angle[0]
        self.bend = np.diff(np.r_[self.root, self.rest])
        self.stiff = np.full(self.count, EI / self.h)
        self.stiff[0] *= 2
        self.d = np.eye(self.count) - np.eye(self.count, k=-1)

    def state(self, a, base, poly):
        nodes = np.cumsum(np.c_[np.cos(a), np.sin(a)] * self.h, 0) + [base, 0]
        depth, normal = deepest(nodes, poly)
        turned = np.diff(np.r_[self.root, a]) - self.bend
        return 0.5 * (self.stiff * turned**2).sum() + 0.5 * WALL_N_PER_MM2 * (depth**2).sum(), turned, nodes, depth, normal

    def press(self, a, base, poly):
        """Equilibrium from a near one: link angles, moment at the root, and where the wire touches most, world mm."""
        energy, turned, nodes, depth, normal = self.state(a, base, poly)
        for _ in range(200):
            grad, hess = self.d.T @ (self.stiff * turned), self.d.T @ (self.stiff[:, None] * self.d)
            touching = np.flatnonzero(depth < 0)
            if len(touching):
                by = normal[touching, :1] * -np.sin(a) * self.h + normal[touching, 1:] * np.cos(a) * self.h
                by *= np.arange(self.count) <= touching[:, None]
                grad, hess = grad + WALL_N_PER_MM2 * by.T @ depth[touching], hess + WALL_N_PER_MM2 * by.T @ by
            step = np.linalg.solve(hess, -grad)
            step *= min(1, 0.05 / max(np.abs(step).max(), 1e-12))
            part = 1.0
            while (new := self.state(a + part * step, base, poly))[0] > energy + 1e-12 and part > 1e-4:
                part /= 2
            a = a + part * step
            energy, turned, nodes, depth, normal = new
            if np.abs(part * step).max() < 1e-8:
                break
        force = -WALL_N_PER_MM2 * depth[:, None] * normal
        moment = ((nodes[:, 0] - base) * force[:, 1] - nodes[:, 1] * force[:, 0]).sum()
        return a, moment, nodes[depth.argmin()] if depth.min() < 0 else None


def deepest(points, poly):
    """By how much the wire is in the outline (at most 0), and the outward normal there."""
    along = np.roll(poly, -1, 0) - poly
    length = np.linalg.norm(along, axis=1)
    along = along / length[:, None]
    out = np.c_[along[:, 1], -along[:, 0]]
    off = points[:, None] - poly
    u = np.clip((off * along).sum(2), 0, length)
    gap = points[:, None] - (poly + along * u[:, :, None])
    far = np.linalg.norm(gap, axis=2)
    k = far.argmin(1)
    pick = np.arange(len(points))
    side = np.where(((off * out).sum(2) > 0).any(1), 1.0, -1.0)
    normal = np.where(far[pick, k, None] > 1e-9, side[:, None] * gap[pick, k] / np.maximum(far[pick, k, None], 1e-9), out[k])
    return np.minimum(side * far[pick, k] - DIAMETER_MM / 2, 0), normal


def beside(name, contacts, touch):
    """contacts: k -> place in the world."""
    off = [math.dist(contacts[k], at) for k, at in touch.items() if k in contacts and FIRST <= k <= LAST]
    off.sort()
    print(f"{name}: {len(off)} contacts, {np.mean(off):.2f} mm in the mean from the places of the statics, median {off[len(off) // 2]:.2f}, largest {off[-1]:.2f}")


def main():
    wire, poly = Wire(), outline()
    base = [float(r["base_x_mm"]) for r in rows(SWEEP / "points.csv")]
    released = [float(r["released_moment_2_nmm"]) for r in rows(SWEEP / "readings.csv")]
    print(f"{len(poly)} corners of the outline; k, moment by statics and as released (N mm), ratio, touch in the world (mm)")
    a, x, touch = wire.rest.copy(), base[3], {}
    for k in range(3, len(base)):
        steps = max(math.ceil(abs(base[k] - x) / STEP_MM), 1)
        for j in range(1, steps + 1):
            a, moment, at = wire.press(a, x + (base[k] - x) * j / steps, poly)
        x = base[k]
        if at is not None:
            touch[k] = at
            if k % 3 == 2 and released[k] < 0:
                print(f"{k:3d} {moment:7.3f} {-released[k]:7.3f} {moment / -released[k]:6.3f}   {at[0]:7.2f} {at[1]:6.2f}", flush=True)
    place = lambda r: (float(r["world_x_mm"]), float(r["world_y_mm"]))
    beside("released network", {int(r["k"]): place(r) for r in rows(SWEEP / "released_contacts.csv")}, touch)
    for path in sys.argv[1:]:
        beside(path, {k: place(r) for k, r in enumerate(rows(path)) if r["world_x_mm"]}, touch)


if __name__ == "__main__":
    main()
