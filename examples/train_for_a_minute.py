"""Train for a minute with Stable-Baselines3: `python examples/train_for_a_minute.py [SAMPLES]`.

It learns to stay up a little longer; a policy that walks takes `footfall train` and an hour. Needs
`pip install stable-baselines3`.
"""

import sys

from stable_baselines3 import PPO

import footfall

samples = int(sys.argv[1]) if len(sys.argv) > 1 else 20_000
env = footfall.make_env("jvrc1", mode="forward")
learner = PPO("MlpPolicy", env, n_steps=min(512, samples), batch_size=64, device="cpu", seed=0)
learner.learn(total_timesteps=samples)

observation, _ = env.reset(seed=1)
ticks, fallen = 0, False
while not fallen and ticks < 400:
    action, _ = learner.predict(observation, deterministic=True)
    observation, _, fallen, _, _ = env.step(action)
    ticks += 1
print(f"after {samples} control steps it stays up for {ticks * 0.025:.1f} s")
