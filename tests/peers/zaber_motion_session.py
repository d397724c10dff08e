"""Runs the stage maker's own client (zaber-motion) against the virtual stage, over TCP and the pseudo-terminal.

Usage: zaber_motion_session.py ADDRESSES [--out JSON]
ADDRESSES is the JSON line of a virtual bench. Faults are asked for by printing `inject NAME`; the bench's owner answers
with a line. Driven by rigs/drivers/tests/drivers/vendor_client.rs; by hand, press Enter after typing the fault into the bench.
"""
import argparse
import json
import sys
import time
from importlib.metadata import version

from zaber_motion import MotionLibException, CommandFailedException, MovementFailedException
from zaber_motion.ascii import Connection


def check(rows, what, passed, detail=""):
    rows.append({"what": what, "met": bool(passed), "note": str(detail)})


def session(connection, checksums, inject, rows, label):
    connection.checksum_enabled = checksums
    devices = connection.detect_devices(identify_devices=False)
    check(rows, f"{label}: detect_devices finds the chain", len(devices) == 2, len(devices))
    device = devices[0]
    axis = device.get_axis(1)
    device.settings.set("comm.alert", 0)
    axis.warnings.clear_flags()
    if not axis.is_homed():
        check(rows, f"{label}: an unreferenced axis shows WR", "WR" in axis.warnings.get_flags())
    axis.home()
    check(rows, f"{label}: home ends at 0 with a reference", axis.settings.get("pos") == 0 and axis.is_homed())
    axis.move_absolute(100_000)
    check(rows, f"{label}: move abs ends at its target", axis.settings.get("pos") == 100_000, axis.settings.get("pos"))
    axis.move_relative(-5_000)
    check(rows, f"{label}: move rel", axis.settings.get("pos") == 95_000)
    axis.move_velocity(200_000)
    time.sleep(0.2)
    check(rows, f"{label}: busy while at constant speed", axis.is_busy())
    axis.stop()
    stopped = axis.settings.get("pos")
    time.sleep(0.1)
    check(rows, f"{label}: stop stops", not axis.is_busy() and axis.settings.get("pos") == stopped > 95_000, stopped)
    check(rows, f"{label}: no warning is left", not (axis.warnings.get_flags() - {"NI"}), axis.warnings.get_flags())
    try:
        axis.move_absolute(9_999_999)
        check(rows, f"{label}: a target out of travel is refused", False)
    except CommandFailedException as error:
        check(rows, f"{label}: a target out of travel is refused", error.details.response_data == "BADDATA", error.details.response_data)
    try:
        device.generic_command("dance")
        check(rows, f"{label}: an unknown command is refused", False)
    except CommandFailedException as error:
        check(rows, f"{label}: an unknown command is refused", error.details.response_data == "BADCOMMAND")
    device.settings.set("comm.alert", 1)
    axis.move_absolute(120_000)
    check(rows, f"{label}: a move with alerts on", axis.settings.get("pos") == 120_000)
    device.settings.set("comm.alert", 0)
    check(rows, f"{label}: the limit is read", axis.settings.get("limit.max") == 2_133_333)
    axis.move_absolute(0)
    inject("stall")
    try:
        axis.move_absolute(50_000)
        check(rows, f"{label}: a stall is a failed movement", False)
    except MovementFailedException as error:
        check(rows, f"{label}: a stall is a failed movement", "FS" in error.details.warnings, error.details.warnings)
    axis.warnings.clear_flags()
    start = time.perf_counter()
    for _ in range(500):
        axis.settings.get("pos")
    check(rows, f"{label}: 500 positions read", True, f"{500 / (time.perf_counter() - start):.0f} replies/s")
    return device, axis


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("addresses")
    parser.add_argument("--out")
    arguments = parser.parse_args()
    addresses = json.loads(arguments.addresses)

    def inject(fault):
        print("inject", fault, flush=True)
        sys.stdin.readline()

    rows = []
    host, port = addresses["stage_tcp"].split(":")
    opened = [
        ("TCP", lambda: Connection.open_tcp(host, int(port))),
        ("PTY", lambda: Connection.open_serial_port(addresses["stage_pty"])),
    ]
    for name, opener in opened:
        for checksums in (False, True):
            with opener() as connection:
                label = f"{name} {'with' if checksums else 'without'} checksums"
                session(connection, checksums, inject, rows, label)
    # Negative control: a lost reply must be seen by the client.
    with Connection.open_tcp(host, int(port)) as connection:
        axis = connection.get_device(1).get_axis(1)
        connection.default_request_timeout = 300
        inject("lose-reply")
        try:
            axis.settings.get("pos")
            check(rows, "control: a lost reply is a timeout", False)
        except MotionLibException as error:
            check(rows, "control: a lost reply is a timeout", "Timeout" in type(error).__name__, type(error).__name__)
    for row in rows:
        row["peer"] = f"zaber-motion {version('zaber-motion')}"
        print("ok  " if row["met"] else "FAIL", row["what"], row["note"])
    if arguments.out:
        with open(arguments.out, "w", encoding="utf-8") as file:
            json.dump({"rows": rows}, file, indent=1)
    sys.exit(0 if all(row["met"] for row in rows) else 1)


if __name__ == "__main__":
    main()
