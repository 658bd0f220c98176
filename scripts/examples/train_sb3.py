"""Train a car with Stable-Baselines3: `python scripts/examples/train_sb3.py [--total-steps N]`.

Needs Stable-Baselines3, which is no part of this project: pip install stable-baselines3
"""

import argparse
import sys

import drsim  # makes the ids known to Gymnasium


def main() -> int:
    """Train, then drive with the most likely actions.

    Returns:
        The exit code: 1 where Stable-Baselines3 is missing.
    """
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--world", default="reinvent_base")
    parser.add_argument("--race", default="time_trial", help="object_avoidance, head_to_bot")
    parser.add_argument("--total-steps", type=int, default=30_000)
    parser.add_argument("--num-envs", type=int, default=8)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    try:
        from stable_baselines3 import PPO
        from stable_baselines3.common.env_util import make_vec_env
    except ImportError:
        print(
            "This example needs Stable-Baselines3: pip install stable-baselines3", file=sys.stderr
        )
        return 1

    arguments = {"world": options.world, "race": options.race}
    envs = make_vec_env(
        "drsim/DeepRacer-v0", n_envs=options.num_envs, seed=options.seed, env_kwargs=arguments
    )
    model = PPO(
        "CnnPolicy",
        envs,
        n_steps=128,
        batch_size=64,
        n_epochs=3,
        gamma=0.95,
        learning_rate=3e-4,
        seed=options.seed,
        verbose=1,
    )
    model.learn(options.total_steps)
    envs.close()

    env = drsim.RacerEnv(**arguments, start=0.0)
    frame, info = env.reset(seed=options.seed)
    ended = False
    while not ended:
        action, _ = model.predict(frame, deterministic=True)
        frame, _, terminated, truncated, info = env.step(int(action))
        ended = terminated or truncated
    print(f"{info['status']} after {info['steps'] / 15:.1f} s, progress {info['progress']:.1f} %")
    env.close()
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
