#!/usr/bin/env python3
"""WhiskerNet side by side with PyTorch on the CPU: a training step (batch 64 x 100, preset `paper`) and a streamed token, one thread each.

    network_peers.py target/release/examples/network_time [--steps 7] [--tokens 2000] --json peers-network.json

Installs torch in tests/peers/.venv-torch on the first run (PyPI's wheel; nothing but its CPU part is used). The peer is the same network
with the same weights, read from what the Rust program wrote: its answers are compared first, and a difference above 1e-4 is an error.
PyTorch takes its fused attention, both as shipped and, for streaming, with a key-value cache of its own. Ours and theirs take turns. CPU
time of the process is what the ratio is made of: the machine may be shared; wall time is printed beside.
"""

import argparse
import json
import os
import pathlib
import statistics
import subprocess
import sys
import tempfile
import time

import peer_env

for name in ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "RAYON_NUM_THREADS"):
    os.environ[name] = "1"


HEADS, CONTEXT, BATCH, TIME = 8, 128, 64, 100


def slope(head):
    """Fall of attention with time, 1/s."""
    return 4.0 * 0.02 ** (head / (HEADS - 1))


def network(weights, dropout):
    """The same network out of its weights."""
    import torch
    from torch import nn
    from torch.nn import functional as F

    width, inputs = weights["encode_out.weight"].shape[1], weights["encode.weight"].shape[0]
    layers = 1 + max(int(k.split(".")[1]) for k in weights if k.startswith("blocks."))
    feed, outputs = weights["blocks.0.widen.weight"].shape[1], weights["head.weight"].shape[1]

    class Block(nn.Module):
        def __init__(self):
            super().__init__()
            self.before_attention, self.before_feed = nn.LayerNorm(width), nn.LayerNorm(width)
            self.query_key_value, self.out = nn.Linear(width, 3 * width), nn.Linear(width, width)
            self.widen, self.narrow = nn.Linear(width, feed), nn.Linear(feed, width)
            self.dropout = nn.Dropout(dropout)

        def forward(self, x, bias, cache=None):
            batch, time_, _ = x.shape
            qkv = self.query_key_value(self.before_attention(x))
            q, k, v = qkv.view(batch, time_, 3, HEADS, width // HEADS).permute(2, 0, 3, 1, 4)
            if cache is not None:
                if cache:
                    k = torch.cat((cache[0], k), 2)[:, :, -CONTEXT:]
                    v = torch.cat((cache[1], v), 2)[:, :, -CONTEXT:]
                cache[:] = k, v
            attended = F.scaled_dot_product_attention(q, k, v, attn_mask=bias)
            x = x + self.dropout(self.out(attended.transpose(1, 2).reshape(batch, time_, width)))
            return x + self.dropout(self.narrow(F.gelu(self.widen(self.before_feed(x)))))

    class WhiskerNet(nn.Module):
        def __init__(self):
            super().__init__()
            hidden = weights["encode.weight"].shape[1]
            self.encode, self.encode_out = nn.Linear(inputs, hidden), nn.Linear(hidden, width)
            self.blocks = nn.ModuleList(Block() for _ in range(layers))
            self.norm, self.head = nn.LayerNorm(width), nn.Linear(width, outputs)

        def forward(self, x, bias, caches=None):
            x = self.encode_out(F.gelu(self.encode(x)))
            for k, block in enumerate(self.blocks):
                x = block(x, bias, None if caches is None else caches[k])
            return self.head(self.norm(x))

    net = WhiskerNet()
    state = {}
    for name, value in weights.items():
        parts = name.rsplit(".", 1)
        norm = "norm" in parts[0] or "before" in parts[0]
        last = {"gamma": "weight", "beta": "bias"}.get(parts[1], parts[1])
        state[f"{parts[0]}.{last}"] = value if norm or last == "bias" else value.T.contiguous()
    net.load_state_dict(state)
    return net


def attention_bias(times):
    """As ours: the past falls off with time, later tokens and those beyond the context are out of sight."""
    import torch

    t = torch.tensor(times, dtype=torch.float32)
    ahead = t[None, :] - t[:, None]
    steps = torch.arange(len(times))
    seen = (steps[None, :] <= steps[:, None]) & (steps[:, None] - steps[None, :] < CONTEXT)
    slopes = torch.tensor([slope(h) for h in range(HEADS)])[:, None, None]
    return torch.where(seen, slopes * ahead, torch.tensor(-1e9))


def theirs(folder, steps, tokens):
    """Times of PyTorch, and how far its answers are from ours."""
    import numpy
    import torch
    from safetensors.torch import load_file

    torch.set_num_threads(1)
    if torch.get_num_interop_threads() != 1:
        torch.set_num_interop_threads(1)
    weights = load_file(folder / "net.safetensors")
    read = lambda name, last: torch.from_numpy(
        numpy.fromfile(folder / name, dtype="<f4").reshape(BATCH, TIME, last)
    )
    net = network(weights, 0.1)
    wide = weights["encode.weight"].shape[0]
    inputs, targets = read("inputs.f32", wide), read("targets.f32", 3)
    times = [[0.1 * k for k in range(TIME)]] * BATCH
    bias = lambda: torch.stack([attention_bias(times[0])] * BATCH)
    net.eval()
    with torch.no_grad():
        out = net(inputs, bias())
    off = float((out - read("out.f32", out.shape[2])).abs().max())

    net.train()
    optimizer = torch.optim.Adam(net.parameters(), lr=3e-4, betas=(0.9, 0.999), eps=1e-8)
    wall, cpu = [], []
    for _ in range(steps):
        begin, begin_cpu = time.perf_counter(), time.process_time()
        optimizer.zero_grad()
        loss = torch.nn.functional.mse_loss(net(inputs, bias())[..., :3], targets)
        loss.backward()
        optimizer.step()
        wall.append(time.perf_counter() - begin)
        cpu.append(time.process_time() - begin_cpu)

    net.eval()
    caches = [[] for _ in net.blocks]
    row = torch.sin(torch.arange(wide) * 0.37)[None, None]
    ahead = -0.1 * torch.arange(CONTEXT - 1, -1, -1, dtype=torch.float32)
    slopes = torch.tensor([slope(h) for h in range(HEADS)])[:, None, None]
    streamed = []
    with torch.inference_mode():
        for k in range(CONTEXT + tokens):
            begin, begin_cpu = time.perf_counter(), time.process_time()
            net(row, (slopes * ahead[-min(k + 1, CONTEXT) :])[None], caches)
            streamed.append((time.perf_counter() - begin, time.process_time() - begin_cpu))
        # Without a cache: the whole context again for every token, as a training network would be called.
        whole, full = row.expand(1, CONTEXT, wide).contiguous(), attention_bias([0.1 * k for k in range(CONTEXT)])
        again = []
        for _ in range(max(tokens // 20, 10)):
            begin = time.process_time()
            net(whole, full[None])
            again.append(time.process_time() - begin)
    streamed = streamed[CONTEXT:]
    return {
        "off": off,
        "step_s": wall,
        "step_cpu_s": cpu,
        "token_us": [1e6 * s[0] for s in streamed],
        "token_cpu_us": 1e6 * sum(s[1] for s in streamed) / len(streamed),
        "uncached_us": 1e6 * statistics.median(again),
        "version": torch.__version__,
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program", help="target/release/examples/network_time")
    parser.add_argument("--steps", type=int, default=7, help="steps a round; the first is not counted")
    parser.add_argument("--rounds", type=int, default=2)
    parser.add_argument("--tokens", type=int, default=2000)
    parser.add_argument("--json", help="file for the rows of peers.json")
    arguments = parser.parse_args()
    peer_env.enter(["torch", "safetensors", "numpy"], ["torch", "safetensors", "numpy"], ".venv-torch")
    ours, peer = [], []
    with tempfile.TemporaryDirectory() as place:
        folder = pathlib.Path(place)
        for _ in range(arguments.rounds):
            subprocess.run(
                [arguments.program, str(folder), str(arguments.steps), str(arguments.tokens)], check=True
            )
            ours.append(json.loads((folder / "ours.json").read_text()))
            peer.append(theirs(folder, arguments.steps, arguments.tokens))
    off = max(p["off"] for p in peer)
    if not off < 1e-4:
        sys.exit(f"network_peers: answers: expected within 1e-4 of each other, found {off}")
    middle = lambda rounds, key: statistics.median(x for r in rounds for x in r[key][1:])
    token = lambda rounds: statistics.median(r["token_cpu_us"] for r in rounds)
    name = f"torch {peer[0]['version']}"
    note = f"one thread, CPU time, answers within {off:.0e}"
    wall = lambda key: f"{note}; wall {middle(ours, key):.3g} / {middle(peer, key):.3g}"

    def row(what, our, their, unit, goal, note, least_ratio=1.0):
        ratio = our / their
        return {"what": what, "peer": name, "ours": our, "theirs": their, "unit": unit, "ratio": ratio,
                "goal": goal, "met": ratio <= least_ratio, "note": note}

    rows = [
        row("WhiskerNet training step, batch 64 x 100", middle(ours, "step_cpu_s"), middle(peer, "step_cpu_s"), "s",
            "<= 1.0", wall("step_s")),
        row("WhiskerNet streamed token, both with a cache", token(ours), token(peer), "us", "<= 1.0",
            wall("token_us")),
        row("WhiskerNet streamed token, the peer without a cache", token(ours),
            statistics.median(p["uncached_us"] for p in peer), "us", "<= 1.0", note),
    ]
    rate = 1e6 / token(ours)
    rows.append({"what": "WhiskerNet (preset paper) tokens a second", "peer": "none", "ours": rate, "theirs": 2000.0,
                 "unit": "1/s", "ratio": rate / 2000.0, "goal": ">= 2,000", "met": rate >= 2000.0, "note": note})
    for r in rows:
        print(f"{r['what']:52} {r['ours']:10.4g} {r['theirs']:10.4g} {r['unit']:4} ratio {r['ratio']:6.3f}"
              f"  goal {r['goal']}: {'met' if r['met'] else 'NOT met'}  ({r['note']})")
    if arguments.json:
        pathlib.Path(arguments.json).write_text(json.dumps({"rows": rows}, indent=1) + "\n")


if __name__ == "__main__":
    main()
