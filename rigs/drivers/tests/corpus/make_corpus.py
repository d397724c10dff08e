"""Writes the sm130 byte corpus: streams as different public sources describe them, and what they hold.

Made by hand from the field table of firmware-notes/sm130.md, apart from the Rust code. Not recorded on a unit: no unit was at
hand. Run in this folder; the files are committed.
"""
import json
import random
import struct

GRANULARITY = 1_000_000


def frame(serial, channels, flags=0x20, light=0, error=0, second=1_700_000_000, micro=0):
    counts = [len(c) for c in channels] + [0] * (4 - len(channels))
    head = bytearray(88)
    struct.pack_into("<BBBB", head, 0, 16, 0, 3, flags)
    struct.pack_into("<HBB", head, 4, 12345, 0, light)
    struct.pack_into("<H", head, 12, sum(counts))
    struct.pack_into("<4H", head, 16, *counts)
    struct.pack_into("<HHIII", head, 24, serial & 0xFFFF, 0, serial, micro, second)
    struct.pack_into("<HHI", head, 40, 0, 0, error << 24)
    struct.pack_into("<BBH", head, 48, 2, 1, 88)
    struct.pack_into("<4H4H", head, 52, *[10] * 4, *[300] * 4)
    struct.pack_into("<HHI", head, 68, 1, 0, GRANULARITY)
    struct.pack_into("<II", head, 80, 1_510_000_000, 1_590_000_000)
    peaks = b"".join(struct.pack("<I", round(nm * GRANULARITY)) for c in channels for nm in c)
    return bytes(head) + peaks


def reply(payload, token=b"", inside=False, pad="0"):
    length = len(payload) + (len(token) if inside else 0)
    return str(length).rjust(10, pad).encode() + payload + token


CHANNELS = [[1535.801, 1537.3, 1541.2005], [], [1550.25], []]
X = b"XXXXXXXX"
cases = {}


def case(name, data, serials, skipped, faults=()):
    cases[name] = {"serials": serials, "skipped": skipped, "faults": list(faults)}
    with open(name + ".bin", "wb") as file:
        file.write(data)


frames = [frame(100 + k, CHANNELS, micro=500 * k) for k in range(12)]
all_serials = [100 + k for k in range(12)]
case("token_inside", b"".join(reply(f, X, True) for f in frames), all_serials, 0)
case("token_outside", b"".join(reply(f, X, False) for f in frames), all_serials, 0)
case("no_token_space_padded", b"".join(reply(f, pad=" ") for f in frames), all_serials, 0)
case("start_and_stop", reply(b"Streaming data enabled.\n") + b"".join(reply(f, X, True) for f in frames)
     + reply(b"Streaming data disabled.\n") + b"ZZZZZZZZ", all_serials, 0)
case("stop_token_inside", b"".join(reply(f, X, True) for f in frames)
     + reply(b"Streaming data disabled.\n", b"ZZZZZZZZ", True), all_serials, 0)
rng = random.Random(5)
noise = [bytes(rng.choice(b"\x00\xfe\x80~!") for _ in range(rng.randrange(1, 40))) for _ in frames]
case("noise_between", b"".join(reply(f, X, False) + n for f, n in zip(frames, noise)), all_serials, sum(map(len, noise)))
cut = [reply(f, X, True) for f in frames]
cut[4] = cut[4][:70]
case("one_cut_short", b"".join(cut), all_serials[:4] + all_serials[5:], 70)
case("lost_scans", b"".join(reply(f, X, True) for k, f in enumerate(frames) if k not in (3, 4)),
     [s for s in all_serials if s not in (103, 104)], 0)
case("no_peaks", b"".join(reply(frame(k, []), X, True) for k in range(3)), [0, 1, 2], 0)
case("faults", reply(frame(0, CHANNELS, flags=0x60)) + reply(frame(1, CHANNELS, light=0x02)) + reply(frame(2, CHANNELS, error=9)),
     [0, 1, 2], 0, [["calibration-fault"], ["tec-over-temperature"], ["error-code"]])
with open("expected.json", "w", encoding="utf-8") as file:
    json.dump(cases, file, indent=1)
