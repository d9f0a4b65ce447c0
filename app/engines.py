"""Which physics engine simulates: the options of the commands, and what they load."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Annotated, Optional

from app.options import choice, number
from app.output import InputError, as_bad_input, refuse_given
from controller.gait import CONTROL_PERIOD_S
from sim.drake.contact_model import APPROXIMATIONS, ContactModel, EngineError
from sim.engines import MUJOCO, DrakeEngine, Engine
from sim.robot import Robot

ENGINES = ("mujoco", "drake")
_DEFAULT = ContactModel()


@dataclass(frozen=True, kw_only=True)
class EngineOptions:
    """Which physics engine simulates the walk."""

    engine: Annotated[str, choice(*ENGINES)] = "mujoco"
    """The physics engine, such as drake; the others of its options are in docs/engines.md."""

    contact: Annotated[str, choice(*APPROXIMATIONS)] = _DEFAULT.approximation
    """How Drake's solver treats contact, such as tamsi."""

    contact_modulus: Annotated[float, number(above=0.0)] = _DEFAULT.modulus_pa
    """How stiff soles are in Drake, in Pa, such as 1e7."""

    contact_relaxation: Annotated[float, number(at_least=0.0)] = _DEFAULT.relaxation_s
    """How contacts are damped by sap: a time in s, such as 0.1."""

    contact_dissipation: Annotated[float, number(at_least=0.0)] = _DEFAULT.dissipation_s_m
    """How contacts are damped by all but sap: Hunt and Crossley's, in s/m, such as 1."""

    contact_friction: Annotated[Optional[float], number(at_least=0.0)] = None  # noqa: UP045
    """Coefficient of friction in Drake, such as 0.5; none: the scene's own."""

    contact_time_step: Annotated[float, number(above=0.0)] = _DEFAULT.timestep_s
    """Duration of a physics step in Drake in s, such as 0.0005."""

    @property
    def contact_model(self) -> ContactModel:
        """How bodies touch in Drake."""
        return ContactModel(
            approximation=self.contact,
            modulus_pa=self.contact_modulus,
            relaxation_s=self.contact_relaxation,
            dissipation_s_m=self.contact_dissipation,
            friction=self.contact_friction,
            timestep_s=self.contact_time_step,
        )


def load_engine(options: EngineOptions, robot: Robot) -> Engine:
    """The engine that the options name, which can hold the robot.

    Raises:
        InputError: It is not installed, cannot hold the robot, or an option belongs to another one.
    """
    if options.engine == "mujoco":
        others = [option.name for option in fields(EngineOptions) if option.name != "engine"]
        refuse_given(options, others, "goes with --engine drake: leave it out")
        return MUJOCO
    with as_bad_input(EngineError):
        engine = DrakeEngine(contact=options.contact_model)
        # They are heavy, and only this needs them.
        from sim.drake.plant import require_known
        from sim.scene import PHYSICS_TIMESTEP_S, build_scene
        from sim.simulation import physics_steps

        try:
            physics_steps(CONTROL_PERIOD_S, options.contact_time_step)
        except ValueError as error:
            raise InputError(f"--contact-time-step: {error}") from None
        require_known(build_scene(robot, timestep_s=PHYSICS_TIMESTEP_S).model)
        return engine
