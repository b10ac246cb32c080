"""The peers' own environment under bench/.peers, made at first use; none of them is a dependency of
trueup."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).parent.parent
PEERS = HERE / ".peers"


def peers_python() -> Path:
    """Its interpreter, with everything installed."""
    python, asked = PEERS / "bin" / "python", HERE / "peers" / "requirements.txt"
    stamp = PEERS / "installed.txt"
    if not stamp.exists() or stamp.read_text() != asked.read_text():
        print("installing the peers into an environment of their own …", flush=True)
        subprocess.run([sys.executable, "-m", "venv", PEERS], check=True)
        subprocess.run([python, "-m", "pip", "install", "-q", "-r", asked], check=True)
        stamp.write_text(asked.read_text())
    return python


def run_peer(module: str, cases: Path, out: Path) -> None:
    """Have a peer answer every case in a folder, into another that is made here."""
    out.mkdir()
    subprocess.run(
        [peers_python(), "-m", f"bench.peers.{module}", cases, out],
        check=True,
        stdout=subprocess.DEVNULL,
        cwd=HERE.parent,
    )
