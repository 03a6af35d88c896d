"""An environment with a process of its own, as Unity's, ViZDoom's or SUMO's: close() ends it."""

import subprocess
import sys

import gymnasium


class Simulated(gymnasium.Env):
    observation_space = gymnasium.spaces.Discrete(3)
    action_space = gymnasium.spaces.Discrete(2)

    def __init__(self):
        self.process = subprocess.Popen(
            [sys.executable, "-c", "import time; time.sleep(120)  # simulator"], start_new_session=True
        )

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        return 0, {}

    def step(self, action):
        return 1, 1.0, True, False, {}

    def close(self):
        self.process.kill()
        self.process.wait()
