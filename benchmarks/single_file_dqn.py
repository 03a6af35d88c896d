"""DQN as a researcher writes it in one file, in the manner of CleanRL: one run, on a vector of one environment."""

from __future__ import annotations

import time
from typing import Any

import gymnasium
import numpy as np
import torch
from stable_baselines3.common.buffers import ReplayBuffer
from torch import nn

BUFFER, BATCH, TARGET_EVERY, STARTS = 50_000, 32, 500, 1_000


class Dueling(nn.Module):
    """A body of 64–64, and streams of 256 units for value and advantages."""

    def __init__(self) -> None:
        super().__init__()
        self.body = nn.Sequential(nn.Linear(4, 64), nn.ReLU(), nn.Linear(64, 64), nn.ReLU())
        self.advantage = nn.Sequential(nn.Linear(64, 256), nn.ReLU(), nn.Linear(256, 2))
        self.value = nn.Sequential(nn.Linear(64, 256), nn.ReLU(), nn.Linear(256, 1))

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Q(s, ·)."""
        features = self.body(x)
        advantage = self.advantage(features)
        return self.value(features) + advantage - advantage.mean(-1, keepdim=True)


def plain_network() -> nn.Module:
    """A body of 64–64."""
    return nn.Sequential(nn.Linear(4, 64), nn.ReLU(), nn.Linear(64, 64), nn.ReLU(), nn.Linear(64, 2))


def steps_per_second(seed: int, seconds: float, *, dueling: bool) -> float:
    """Train for so long, once training has begun; steps per second of processor time from then on."""
    torch.set_num_threads(1)
    torch.manual_seed(seed)
    generator = np.random.default_rng(seed)
    envs = gymnasium.vector.SyncVectorEnv([lambda: gymnasium.make("CartPole-v1", max_episode_steps=200)])
    online, target = (Dueling() if dueling else plain_network() for _ in range(2))
    target.load_state_dict(online.state_dict())
    optimizer = torch.optim.Adam(online.parameters(), lr=5e-4)
    space: Any = envs.single_observation_space
    buffer = ReplayBuffer(BUFFER, space, envs.single_action_space, "cpu", handle_timeout_termination=False)
    obs, _ = envs.reset(seed=seed)
    step, began = 0, 0.0
    while not began or time.process_time() - began < seconds:
        epsilon = max(1.0 - 0.98 * step / 10_000, 0.02)
        if generator.random() < epsilon:
            actions = np.array([envs.single_action_space.sample()])
        else:
            actions = online(torch.Tensor(obs)).argmax(1).numpy()
        next_obs, rewards, terminations, _, infos = envs.step(actions)
        buffer.add(obs, next_obs, actions, rewards, terminations, infos)  # type: ignore[arg-type]
        obs = next_obs
        step += 1
        if step > STARTS:
            train(online, target, optimizer, buffer)
            if step % TARGET_EVERY == 0:
                target.load_state_dict(online.state_dict())
        if step == STARTS + 200:
            began, counted_from = time.process_time(), step
    return (step - counted_from) / (time.process_time() - began)


def train(online: nn.Module, target: nn.Module, optimizer: torch.optim.Optimizer, buffer: ReplayBuffer) -> None:
    """One minibatch: double Q-learning, Huber loss, clipped gradients."""
    data = buffer.sample(BATCH)
    with torch.no_grad():
        best = online(data.next_observations).argmax(1, keepdim=True)
        following = target(data.next_observations).gather(1, best).squeeze(1)
        wanted = data.rewards.flatten() + following * (1 - data.dones.flatten())
    predicted = online(data.observations).gather(1, data.actions).squeeze(1)
    loss = nn.functional.smooth_l1_loss(predicted, wanted)
    optimizer.zero_grad()
    loss.backward()
    nn.utils.clip_grad_norm_(online.parameters(), 10.0)
    optimizer.step()
