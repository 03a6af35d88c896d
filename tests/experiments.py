"""Experiments that several tests play."""

from __future__ import annotations

from pathlib import Path

SMALL = """
name: small-maze
seed: 1234
runs: 6
episodes: 80
environment:
  id: apel/Maze-v0
  run_seed: maze_seed
  options: {size: 5, distractors: [3], max_steps: 100}
variables:
  dropped: [x, y, distractor]
learners:
  Q_full: {type: q_learning}
  Q_red: {type: q_learning, representation: {exclude: [$dropped]}}
arms:
  Q_full: {learners: [Q_full]}
  APEL: {learners: [Q_full, Q_red], selector: {type: apel, decay: 0.01}}
  SSBAS: {learners: [Q_full, Q_red], selector: {type: ssbas}}
criterion: {measure: length, window: 10, below: {factor: 1.3, info: optimal_length}}
record: all
"""

_SLOW = """
name: slow
runs: 4
episodes: 1000
record: all
environment: {{id: "user_code:Corridor", options: {{slow_while: "{file}"}}}}
learners: {{W: {{type: "user_code:Walker"}}, Q: {{type: q_learning}}}}
arms: {{both: {{learners: [W, Q], selector: {{type: apel}}}}}}
"""


def write_slow(folder: Path) -> Path:
    """Write ``slow.yaml`` and the modules that it names; the file that makes it slow while it is there.

    For what is done to a job that is at work: it sleeps, twenty episodes a second, where one that computes would hold
    up all that is asked of it.
    """
    (folder / "user_code.py").write_text((Path(__file__).parent / "user_code.py").read_text())
    file = folder / "slow"
    file.touch()
    (folder / "slow.yaml").write_text(_SLOW.format(file=file))
    return file
