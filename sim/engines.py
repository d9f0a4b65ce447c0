"""The physics engines by name; each is loaded when it simulates."""

from __future__ import annotations

import importlib.metadata
import importlib.util
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

from sim.drake.contact_model import ContactModel, EngineError

if TYPE_CHECKING:
    from sim.scene import Scene
    from sim.simulation import Simulation


class Engine(Protocol):
    """A physics engine: what sets simulations up.

    `about` is what reports tell of it: nothing of the engine that policies are trained in.
    """

    @property
    def about(self) -> dict[str, Any] | None:
        """Name, version and settings; None for MuJoCo."""
        ...

    def simulate(
        self,
        scene: Scene,
        *,
        count: int,
        control_period_s: float,
        threads: int = 1,
        record: tuple[str, ...] = (),
    ) -> Simulation:
        """`count` simulations of the scene in half-sitting at the origin; see `Simulation`.

        Args:
            scene: the scene.
            count: B.
            control_period_s: duration of a `step()`.
            threads: for the physics; the result does not depend on it.
            record: fields, such as qvel, that `recorded` holds after each `step()`.

        Raises:
            ValueError: the control period is not a whole number of physics steps.
            EngineError: the engine cannot hold the scene.
        """
        ...


@dataclass(frozen=True)
class MujocoEngine:
    """MuJoCo, in which policies are trained."""

    @property
    def about(self) -> dict[str, Any] | None:
        """Nothing: reports have its version anyway."""
        return None

    def simulate(self, scene: Scene, **settings: Any) -> Simulation:
        """See `Engine`."""
        from sim.batch import SimBatch

        return SimBatch(scene, **settings)


@dataclass(frozen=True, kw_only=True)
class DrakeEngine:
    """Drake, which must be installed.

    Raises:
        EngineError: it is not; the message says how to install it.
    """

    contact: ContactModel = field(default_factory=ContactModel)

    def __post_init__(self) -> None:
        if importlib.util.find_spec("pydrake") is None:
            raise EngineError(
                "--engine drake needs the package drake: python -m pip install -e '.[drake]'"
            )

    @property
    def about(self) -> dict[str, Any] | None:
        """Name, version and contact model."""
        version = importlib.metadata.version("drake")
        return {"name": "drake", "version": version, "contact": asdict(self.contact)}

    def simulate(self, scene: Scene, **settings: Any) -> Simulation:
        """See `Engine`."""
        from sim.drake.batch import DrakeBatch

        return DrakeBatch(scene, contact=self.contact, **settings)


MUJOCO = MujocoEngine()
