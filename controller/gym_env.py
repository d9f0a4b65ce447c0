"""The walking task as Gymnasium environments: `import controller.gym_env` registers one a robot.

`gymnasium.make("Footfall/Jvrc1-v0")` is one robot, `gymnasium.make_vec("Footfall/Jvrc1-v0",
num_envs=256)` many in one batch of simulations. Observation, action, reward and ends of episodes
are those of `WalkTask`.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

from controller.curriculum import Stage
from controller.env import TaskConfig, Transition, WalkTask
from controller.gait import CONTROL_PERIOD_S
from controller.gym_render import RenderState, SceneRenderer
from controller.observation import SCALED_LIMIT, policy_fields
from controller.stairs import STAIR_MODES
from controller.step_sequences import MODES
from sim.robots import get_robot, robot_names

VERSION = 0
# Joint targets are clipped to this distance from half-sitting, which no leg joint needs to exceed.
ACTION_LIMIT_RAD = 2.0
# Fields of a `Transition` that hold for feet that have just landed.
LANDING_ERRORS = ("landing_error_m", "landing_height_error_m", "landing_heading_error_rad")


def clip_to_space(observation: np.ndarray) -> np.ndarray:
    """Observations (B, N) in float32, clipped to the space; numbers that are not finite read 0."""
    limited = np.clip(np.nan_to_num(observation), -SCALED_LIMIT, SCALED_LIMIT)
    return limited.astype(np.float32)


def validated_action(action: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """The action in float64, clipped to its bounds.

    Raises:
        ValueError: wrong shape, or numbers that are not finite.
    """
    action = np.asarray(action, dtype=np.float64)
    if action.shape != shape:
        raise ValueError(f"the action has shape {action.shape}, it must have {shape}")
    if not np.isfinite(action).all():
        raise ValueError("the action has numbers that are not finite")
    return np.clip(action, -ACTION_LIMIT_RAD, ACTION_LIMIT_RAD)


class GymTask(WalkTask):
    """The walking task of an environment, which also keeps the last states of episodes.

    A `WalkTask` starts the next episode within the step that ends one; `last_observation` (B, N)
    and `last_render_state` are from before that. Of one robot, `observations` are scaled and
    clipped as in training (N,), `actions` offsets in rad of the joint targets from half-sitting
    (J,).
    """

    last_observation: np.ndarray
    last_render_state: RenderState

    def __init__(
        self,
        robot: str,
        *,
        count: int = 1,
        mode: str | None = None,
        render_mode: str | None = None,
        **settings: Any,
    ):
        """Set `count` robots up; other settings are those of `WalkTask`.

        Raises:
            ValueError: unknown robot, mode or render mode, or a count below 1.
            NoGlError: render_mode is set and no GL library works here.
        """
        if render_mode not in (None, "rgb_array"):
            raise ValueError(f"render_mode {render_mode!r}: choose 'rgb_array' or None")
        modes = (*MODES, *STAIR_MODES, "standing")
        if mode is not None and mode not in modes:
            raise ValueError(f"mode {mode!r}: choose one of {', '.join(modes)}, or None for a mix")
        if count < 1:
            raise ValueError(f"num_envs {count} must be at least 1")
        # Generators of seeds for the episodes of each robot, where each has its own, and the last.
        self._seeders: list[np.random.Generator] = []
        self._seeds, self._begins_again = [0] * count, False
        super().__init__(get_robot(robot), count=count, seed=0, mode=mode, **settings)
        self._renderer = SceneRenderer(self.walker.scene) if render_mode else None
        width = sum(field.width for field in policy_fields(self.robot))
        self.observations = spaces.Box(-SCALED_LIMIT, SCALED_LIMIT, (width,), np.float32)
        joints, limit_rad = len(self.robot.joints), ACTION_LIMIT_RAD
        self.actions = spaces.Box(-limit_rad, limit_rad, (joints,), np.float32)

    def reset(self, rows: np.ndarray) -> None:
        """Keep the last states of the episodes of the robots `rows`, and start new ones."""
        if len(rows):
            self.last_observation, self.last_render_state = self.observe(), self._render_state()
        super().reset(rows)

    def reset_again(self, rows: np.ndarray) -> np.ndarray:
        """Start the episodes of the robots `rows` anew, keeping no last states; observes (B, N)."""
        self._begins_again = True
        super().reset(rows)
        self._begins_again = False
        return self.observe()

    def _episode_rng(self, row: int) -> np.random.Generator:
        if not self._seeders:
            return super()._episode_rng(row)
        if not self._begins_again:
            self._seeds[row] = int(self._seeders[row].integers(2**63))
        return np.random.default_rng(self._seeds[row])

    @property
    def has_own_seeds(self) -> bool:
        """Whether each robot draws its episodes from a seed of its own."""
        return bool(self._seeders)

    def begin_each(
        self, seeds: Sequence[int | None] | None, options: dict[str, Any] | None
    ) -> np.ndarray:
        """As `begin`, but each robot draws its episodes from a seed of its own, as a `WalkEnv`.

        What disturbs them is drawn from all seeds together. None: the next episodes from the seeds
        given before.

        Raises:
            ValueError: another number of seeds than robots, a seed below 0, or options.
        """
        if seeds is None:
            return self._restart([rng.spawn(1)[0] for rng in self._seeders], options)
        if len(seeds) != self.count:
            raise ValueError(f"{len(seeds)} seeds for {self.count} robots: give one for each")
        if any(seed is not None and seed < 0 for seed in seeds):
            raise ValueError(f"seeds {list(seeds)} must be 0 or more")
        self._seeders = [seeding.np_random(seed)[0] for seed in seeds]
        return self.begin_each(None, options)

    def begin(self, rng: np.random.Generator, options: dict[str, Any] | None) -> np.ndarray:
        """Start new episodes for all robots; gives their observations (B, N).

        Raises:
            ValueError: there are options; none is known.
        """
        self._seeders = []
        return self._restart([rng], options)

    def _restart(
        self, rngs: Sequence[np.random.Generator], options: dict[str, Any] | None
    ) -> np.ndarray:
        if options:
            raise ValueError(f"reset takes no options here, but got {', '.join(options)}")
        drawn = [int(rng.integers(2**63)) for rng in rngs]
        self.restart(drawn[0] if len(drawn) == 1 else np.random.SeedSequence(drawn))
        return clip_to_space(self.observe())

    def pictures(self, *, ended: bool = False) -> tuple[np.ndarray, ...]:
        """Images (480, 640, 3) of all robots, now or when episodes last ended; none undrawn."""
        if self._renderer is None:
            return ()
        state = self.last_render_state if ended else self._render_state()
        return tuple(self._renderer.draw(state, row) for row in range(len(state.qpos)))

    def close(self) -> None:
        """Free the renderer."""
        if self._renderer is not None:
            self._renderer.close()

    def _render_state(self) -> RenderState:
        cursor = self.walker.cursor
        return RenderState(
            qpos=self.walker.sim.qpos.copy(),
            window=cursor.window,
            side=cursor.side,
            ground=self.walker.sim.ground_pose,
        )


def environment_id(robot: str) -> str:
    """The id of a robot's environment, such as Footfall/Jvrc1-v0; of a robot file's folder too."""
    return f"Footfall/{re.sub(r'[^A-Za-z0-9_.-]+', '_', robot).capitalize()}-v{VERSION}"


class WalkEnv(gymnasium.Env[np.ndarray, np.ndarray]):
    """One robot that follows steps drawn anew every episode.

    The observation (N,) is the policy's, scaled; the action (J,) an offset in rad of the joint
    targets from half-sitting. `info` says whether a step has just ended (`landed`), then with the
    foot's errors from its target, and holds the terms of the reward.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 (as Gymnasium declares it)
        "render_modes": ["rgb_array"],
        "render_fps": round(1 / CONTROL_PERIOD_S),
    }

    def __init__(
        self,
        robot: str = "jvrc1",
        *,
        mode: str | None = None,
        config: TaskConfig | None = None,
        stage: Stage | None = None,
        render_mode: str | None = None,
    ):
        """Set the robot up; `mode` is a walking mode, None for a mix of all.

        `stage` is the rise of stairs and the level of disturbances, by default none.

        Raises:
            ValueError: unknown robot, mode or render mode.
            NoGlError: render_mode is set and no GL library works here.
        """
        self._task = GymTask(robot, mode=mode, config=config, stage=stage, render_mode=render_mode)
        self.render_mode = render_mode
        self.observation_space, self.action_space = self._task.observations, self._task.actions
        self._ended = False

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start a new episode; the same seed gives the same episodes."""
        super().reset(seed=seed)
        self._ended = False
        return self._task.begin(self.np_random, options)[0], {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Act for one control step; the last observation is of the episode that ended."""
        (joints,) = self.action_space.shape or ()
        step = self._task.step(validated_action(action, (joints,))[None])
        terminated, truncated = bool(step.terminated[0]), bool(step.truncated[0])
        self._ended = terminated or truncated
        seen = self._task.last_observation if self._ended else step.observation
        info: dict[str, Any] = {
            "landed": bool(step.landed[0]),
            "stairs": bool(step.stairs[0]),
            "failed": bool(step.failed[0]),
            "reward_terms": step.terms,
        }
        if info["landed"]:
            info |= {name: float(getattr(step, name)[0]) for name in LANDING_ERRORS}
        return clip_to_space(seen)[0], float(step.reward[0]), terminated, truncated, info

    def render(self) -> np.ndarray | None:
        """Image (480, 640, 3) of the robot and its next two steps; None without render_mode."""
        pictures = self._task.pictures(ended=self._ended)
        return pictures[0] if pictures else None

    def close(self) -> None:
        """Free the renderer."""
        self._task.close()


def register(*robots: str) -> None:
    """Register environments of these robots, by default of all that can be built here."""
    for name in robots or robot_names():
        if environment_id(name) not in gymnasium.registry:
            gymnasium.register(
                environment_id(name),
                entry_point="controller.gym_env:WalkEnv",
                vector_entry_point="controller.gym_env:WalkVectorEnv",
                kwargs={"robot": name},
            )


# As is usual with Gymnasium, importing the module registers its environments.
register()


class WalkVectorEnv(gymnasium.vector.VectorEnv[np.ndarray, np.ndarray, np.ndarray]):
    """B robots in one batch of simulations, each following steps of its own.

    Autoreset is Gymnasium's SAME_STEP or NEXT_STEP. In the first, the observation where an episode
    ends is the first of the next one, and `final_obs` and `final_info` hold the last of the old
    one. In the second it is the last of the old one, and the next step begins the new one there,
    whatever its action. Infos are those of `WalkEnv` without the reward's terms, as arrays (B,),
    each with a mask named `_NAME`.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 (as Gymnasium declares it)
        **WalkEnv.metadata,
        "autoreset_mode": AutoresetMode.SAME_STEP,
    }

    def __init__(
        self,
        robot: str = "jvrc1",
        *,
        num_envs: int = 1,
        threads: int = 1,
        mode: str | None = None,
        config: TaskConfig | None = None,
        stage: Stage | None = None,
        render_mode: str | None = None,
        autoreset_mode: str | AutoresetMode = AutoresetMode.SAME_STEP,
    ):
        """Set `num_envs` robots up, with physics in `threads` threads.

        Raises:
            ValueError: unknown robot, mode, render mode or autoreset mode, or num_envs below 1.
            NoGlError: render_mode is set and no GL library works here.
        """
        known = (AutoresetMode.SAME_STEP, AutoresetMode.NEXT_STEP)
        chosen = next((way for way in known if autoreset_mode in (way, way.value)), None)
        if chosen is None:
            names = " or ".join(repr(way.value) for way in known)
            raise ValueError(f"autoreset_mode {autoreset_mode!r}: choose {names}")
        self.metadata = {**self.metadata, "autoreset_mode": chosen}
        self._begins_next = chosen is AutoresetMode.NEXT_STEP
        self._ended = np.zeros(num_envs if num_envs > 0 else 0, dtype=bool)
        self._task = GymTask(
            robot,
            count=num_envs,
            threads=threads,
            mode=mode,
            config=config,
            stage=stage,
            render_mode=render_mode,
        )
        self.num_envs = num_envs
        self.render_mode = render_mode
        self.single_observation_space = self._task.observations
        self.single_action_space = self._task.actions
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start new episodes for all robots from one seed, or from one for each.

        Threads do not change the result.
        """
        self._ended[:] = False
        if seed is None and self._task.has_own_seeds:
            return self._task.begin_each(None, options), {}
        if seed is None or isinstance(seed, (int, np.integer)):
            super().reset(seed=None if seed is None else int(seed))
            return self._task.begin(self.np_random, options), {}
        return self._task.begin_each(seed, options), {}

    def step(
        self, actions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Act (B, J) for one control step."""
        step = self._task.step(validated_action(actions, self.action_space.shape or ()))
        if self._begins_next:
            return self._begin_next(step)
        ended = step.terminated | step.truncated
        infos: dict[str, Any] = dict(_infos(step, ~ended))
        if ended.any():
            final = np.full(self.num_envs, None, dtype=object)
            seen = clip_to_space(self._task.last_observation)
            for row in np.flatnonzero(ended):
                final[row] = seen[row].copy()
            infos |= {"final_obs": final, "_final_obs": ended.copy()}
            infos |= {"final_info": _infos(step, ended), "_final_info": ended.copy()}
        observation = clip_to_space(step.observation)
        return observation, step.reward, step.terminated, step.truncated, infos

    def _begin_next(
        self, step: Transition
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """What NEXT_STEP tells of a step: ends as they are, and beginnings one step after them."""
        begun = self._ended
        terminated, truncated = step.terminated & ~begun, step.truncated & ~begun
        self._ended = terminated | truncated
        observation = step.observation.copy()
        if self._ended.any():
            observation[self._ended] = self._task.last_observation[self._ended]
        if begun.any():
            # They have walked a step of an episode that nobody saw begin.
            observation[begun] = self._task.reset_again(np.flatnonzero(begun))[begun]
        reward = np.where(begun, 0.0, step.reward)
        return clip_to_space(observation), reward, terminated, truncated, _infos(step, ~begun)

    def render(self) -> tuple[np.ndarray, ...] | None:
        """Images (480, 640, 3) of all robots; None without render_mode."""
        return self._task.pictures(ended=bool(self._ended.any())) or None

    def close_extras(self, **kwargs: Any) -> None:
        """Free the renderer."""
        self._task.close()


def _infos(step: Transition, rows: np.ndarray) -> dict[str, np.ndarray]:
    """Infos of the robots where `rows` (B,) is true, with masks."""
    masks = dict.fromkeys(("landed", "stairs", "failed"), rows)
    masks |= dict.fromkeys(LANDING_ERRORS, rows & step.landed)
    infos = {}
    for name, mask in masks.items():
        values = getattr(step, name)
        infos[name] = np.where(mask, values, np.zeros(1, values.dtype))
        infos[f"_{name}"] = mask.copy()
    return infos
