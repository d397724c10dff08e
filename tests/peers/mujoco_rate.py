"""Steps a second: wcal-mujoco against python mujoco on the same model in the same run.

usage: mujoco_rate.py WRITE_WORLD WCAL_MUJOCO [--json FILE]   (needs mujoco==3.17.0; WRITE_WORLD is calib/mujoco's example)
Both load one sweep (base on its slide, star-shaped bar in convex parts), are led over it in turns, and their processor time is taken: on a
shared machine the wall says nothing. Then two engines at once against one: how the rate scales over two cores.
"""
import argparse, json, os, subprocess, tempfile, threading, time
import mujoco
import numpy as np

a = argparse.ArgumentParser()
a.add_argument("write_world")
a.add_argument("wcal_mujoco")
a.add_argument("--json")
a.add_argument("--steps", type=int, default=2000)
a.add_argument("--rounds", type=int, default=6)
a = a.parse_args()


class Engine:
    def __init__(self, xml):
        self.p = subprocess.Popen([a.wcal_mujoco], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self.ask(do="load", xml=xml, cable_plugin=False)

    def ask(self, **request):
        self.p.stdin.write(json.dumps(request) + "\n")
        self.p.stdin.flush()
        reply = json.loads(self.p.stdout.readline())
        assert reply["is"] != "refused", reply
        return reply

    def lead(self, steps):
        before = self.core
        self.ask(do="lead", speed_m_s=0.005, acceleration_m_s2=0.0, steps=steps)
        return steps / (self.core - before)

    @property
    def core(self):
        return self.ask(do="run", steps=0)["core_s"]


class Python:
    def __init__(self, xml):
        self.m = mujoco.MjModel.from_xml_string(xml)
        self.d = mujoco.MjData(self.m)
        self.q = self.m.joint("base").qposadr[0]
        self.v = self.m.joint("base").dofadr[0]

    def lead(self, steps):
        m, d = self.m, self.d
        before = time.thread_time()
        start = d.qpos[self.q]
        for k in range(steps):
            d.qpos[self.q] = start + 0.005 * k * m.opt.timestep
            d.qvel[self.v] = 0.005
            mujoco.mj_step(m, d)
        d.qpos[self.q] = start + 0.005 * steps * m.opt.timestep
        return steps / (time.thread_time() - before)


with tempfile.TemporaryDirectory() as folder:
    path = os.path.join(folder, "world.xml")
    subprocess.run([a.write_world, folder, path], check=True)
    xml = open(path).read()
ours, theirs = Engine(xml), Python(xml)
rates = [(ours.lead(a.steps), theirs.lead(a.steps)) for _ in range(a.rounds)]
o, t = np.median(rates, axis=0)
print(f"steps a second and core: wcal-mujoco {o:.0f}, python mujoco {t:.0f}, ratio {o / t:.3f} (medians of {a.rounds} x {a.steps} steps, MuJoCo {mujoco.__version__})")
one = Engine(xml)
alone = one.lead(a.steps * 2)
pair = [Engine(xml), Engine(xml)]
both = [0.0, 0.0]
threads = [threading.Thread(target=lambda k=k: both.__setitem__(k, pair[k].lead(a.steps * 2))) for k in (0, 1)]
[x.start() for x in threads]
[x.join() for x in threads]
print(f"two at once: {sum(both):.0f} steps a second of processor time against {alone:.0f} alone, {sum(both) / alone:.2f} x over two cores")
if a.json:
    json.dump({"mujoco": mujoco.__version__, "ours": o, "theirs": t, "ratio": o / t, "two_cores": sum(both) / alone}, open(a.json, "w"), indent=1)
