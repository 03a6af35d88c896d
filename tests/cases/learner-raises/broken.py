import numpy as np


class Broken:
    off_policy = True

    def __init__(self, observation_space, action_space, seed, after=300):
        self.rng = np.random.default_rng(seed)
        self.n, self.after, self.steps = action_space.n, after, 0

    def act(self, observation):
        return int(self.rng.integers(self.n)), None

    def learn(self, step):
        self.steps += 1
        if self.steps > self.after:
            self._helper(step)

    def _helper(self, step):
        target = {"a": 1}
        return target["missing_key"]  # line 22: KeyError

    def end_episode(self):
        pass

    def state(self):
        return {"steps": self.steps, "rng": self.rng.bit_generator.state}

    def restore(self, state):
        self.steps = state["steps"]
        self.rng.bit_generator.state = state["rng"]
