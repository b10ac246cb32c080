"""What a shell proposes, by the completion script that the command prints."""

import os
import subprocess
import sys
from pathlib import Path


def completed(line, script, **environment):
    """What a shell proposes for the last word of a line."""
    words = line.split(" ")
    typed = (
        f'source "$1"; COMP_WORDS=({line}); COMP_CWORD={len(words) - 1}; _trueup; '
        'echo "${COMPREPLY[@]}"'
    )
    command = ["bash", "-c", typed, "_", script]
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    here = {**os.environ, "PATH": path, **environment}
    done = subprocess.run(command, capture_output=True, text=True, check=True, env=here)
    return done.stdout.split()
