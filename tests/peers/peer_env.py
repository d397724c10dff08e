"""The virtual environment that a peer script runs in."""
import os
import pathlib
import subprocess
import sys

HERE = pathlib.Path(__file__).resolve().parent


def enter(modules, packages, name=".venv"):
    """Runs this script again inside tests/peers/NAME; installs `packages` (PyPI) there where `modules` cannot be imported."""
    folder = HERE / name
    python = folder / "bin" / "python"
    if pathlib.Path(sys.prefix) == folder:
        return
    if not python.exists():
        subprocess.run([sys.executable, "-m", "venv", str(folder)], check=True)
    if subprocess.run([str(python), "-c", f"import {', '.join(modules)}"], capture_output=True).returncode:
        subprocess.run([str(python), "-m", "pip", "install", "--quiet", *packages], check=True)
    os.execv(str(python), [str(python), *sys.argv])
