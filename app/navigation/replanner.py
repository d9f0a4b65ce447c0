"""Who asks for plans for a live robot, and takes the answers up."""

from __future__ import annotations

import time
from dataclasses import dataclass

from app.navigation.live_navigator import LiveNavigator, Notice, ReplanPoint, WalkHistory
from app.navigation.planner_process import Answer, PlannerProcess
from app.navigation.report import Outcome
from app.navigation.route import Waypoint, first_leg
from planner.plan import FootstepPlan, Pose, finite_pose


@dataclass(frozen=True, kw_only=True)
class Question:
    """What the planner was asked, from which moment, and for which goal.

    fresh: somebody has set this goal; otherwise it is the way to the old one that is asked for.
    target: where the robot stands next, at the goal or at a waypoint before it.
    in_the_way: what was seen at the goal already when it was pointed at.
    """

    number: int
    replan_point: ReplanPoint
    goal: Pose
    fresh: bool
    asked_s: float
    target: Pose
    in_the_way: str = ""


class Replanner:
    """Asks for one robot at a time, the `navigator`; used from one thread.

    `waypoints` are those that are still ahead on the way to the goal; one that is passed goes.
    `notice` is what there is to be told of. `answer_s` is the real time that the last question took
    until its first answer, and `answer_of` that question's number; `answer` is the latest.
    """

    def __init__(
        self, planner: PlannerProcess, history: WalkHistory, navigator: LiveNavigator
    ) -> None:
        self._planner, self._history = planner, history
        self.answer_of = self._followed_number = -1
        self.waypoints: tuple[Waypoint, ...] = ()
        self.take(navigator)

    def take(self, navigator: LiveNavigator) -> None:
        """Leads this robot from now on; whatever was asked for another one is forgotten."""
        self.navigator = navigator
        self.question: Question | None = None
        self.notice: Notice | None = None
        self.preview: FootstepPlan | None = None
        self.answer_s: float | None = None
        self.answer: Answer | None = None
        self._goal = finite_pose(navigator.goal)
        # The plan in force, and how many of its poses have been passed.
        self._route: FootstepPlan | None = None
        self._passed = 0
        self._history.begin(navigator)

    @property
    def shown_plan(self) -> tuple[FootstepPlan | None, int]:
        """The plan to be seen, and how many of its steps have been taken."""
        navigator = self.navigator
        if navigator.waiting is not None:
            return navigator.waiting, 0
        if self.question is not None and self.preview is not None and not navigator.going:
            return self.preview, 0
        if not navigator.followed:
            return None, 0
        begun_s, plan = navigator.followed[-1]
        return plan, sum(placed.time_s > begun_s for placed in navigator.placed)

    @property
    def goal(self) -> Pose | None:
        """Where the robot walks or has walked to; None of one that was stopped."""
        navigator = self.navigator
        return self._goal if navigator.plans and not navigator.halted else None

    @property
    def goes_on(self) -> bool:
        """Whether it stands at a waypoint and is about to walk on."""
        is_on_way = self.question is not None and not self.question.fresh
        return is_on_way and self.navigator.outcome is Outcome.REACHED

    @property
    def wanted(self) -> Pose | None:
        """The goal that is being planned for, or else the one in force."""
        return self.goal if self.question is None else self.question.goal

    @property
    def requested(self) -> Pose | None:
        """The goal that somebody has set and that nobody has begun to walk to."""
        question = self.question
        return question.goal if question is not None and self._is_new_walk(question) else None

    def ask(self, goal: Pose, *, fresh: bool, in_the_way: str = "") -> None:
        """Asks for a way to the goal; see Question."""
        if self.navigator.has_ended:
            self.notice = Notice(text=f"the robot has {self.navigator.outcome}: reset it first")
            return
        self.notice = None if fresh else self.notice
        replan_point = self.navigator.replan_point()
        via, target = first_leg(self.waypoints, goal)
        number = self._planner.ask(
            goal=target,
            start_feet_world=replan_point.feet_world,
            first_side=replan_point.first_side,
            via=via,
            stands=any(waypoint.stands for waypoint in self.waypoints),
        )
        self.question = Question(
            number=number,
            replan_point=replan_point,
            goal=goal,
            fresh=fresh,
            asked_s=time.monotonic(),
            target=target,
            in_the_way=in_the_way,
        )

    def listen(self) -> None:
        """Takes the answers that have come."""
        for answer in self._planner.answers() if self.question else []:
            question = self.question
            if question is not None and answer.number == question.number:
                self._answered(question, answer)

    def ticked(self) -> None:
        """Notes which waypoints are passed, and sees to it that the question is still asked."""
        self._pass_waypoints()
        if self.question is not None and self.question.number != self._planner.number:
            # The navigator asked in between, when its wait was over, and got its answer.
            self._ask_again(self.question)

    def _pass_waypoints(self) -> None:
        navigator = self.navigator
        route = navigator.followed[-1][1] if navigator.followed else None
        if route is not self._route:
            self._route, self._passed = route, 0
        if route is not None:
            via = [waypoint.pose for waypoint in route.waypoints if not waypoint.stands]
            passed = len(via) - len(navigator.ahead)
            for pose in via[self._passed : passed]:
                self._leave(pose, stands=False)
            self._passed = passed
        reached = navigator.outcome is Outcome.REACHED and self.question is None
        if reached and self._leave(finite_pose(navigator.goal), stands=True):
            navigator.stops += 1
            self.ask(self._goal, fresh=False)

    def _leave(self, pose: Pose, *, stands: bool) -> bool:
        """Whether this is the first waypoint ahead, which then is ahead no longer."""
        if Waypoint(pose=pose, stands=stands) not in self.waypoints[:1]:
            return False
        self.waypoints = self.waypoints[1:]
        return True

    def plan_anew(self) -> None:
        """What was asked is asked again, and what is walked is planned again.

        Meanwhile the robot walks on, but not onto what is there now.
        """
        navigator = self.navigator
        is_led = navigator.going and not (navigator.halted or navigator.has_ended)
        if is_led and not navigator.may_go_on():
            navigator.halt()
        if self.question is not None:
            self._ask_again(self.question)
        elif is_led:
            self.ask(self._goal, fresh=False)

    def stop(self) -> None:
        """Has the robot stand still as soon as possible."""
        self.question = self.preview = None
        if not self.navigator.has_ended:
            self.navigator.halt()

    def _is_new_walk(self, question: Question) -> bool:
        """Whether a plan for it would begin a walk; one that its first plan has begun goes on."""
        return question.fresh and self._followed_number != question.number

    def _ask_again(self, question: Question) -> None:
        fresh = self._is_new_walk(question)
        self.ask(question.goal, fresh=fresh, in_the_way=question.in_the_way)

    def _answered(self, question: Question, answer: Answer) -> None:
        if self.answer_of != question.number:
            self.answer_s = time.monotonic() - question.asked_s
            self.answer_of = question.number
        self.answer = answer
        if answer.is_last:
            self.question = None
        if not answer.plan.found:
            self._no_plan(question, answer)
            return
        self.preview = answer.plan
        if question.replan_point.first_side is None and not answer.is_last:
            return  # It stands: a moment of thought costs nothing.
        self._follow(question, answer.plan)

    def _follow(self, question: Question, plan: FootstepPlan) -> None:
        navigator, begun = self.navigator, self._followed_number == question.number
        is_new_walk = self._is_new_walk(question)
        if navigator.go(question.target, plan, question.replan_point, fresh=is_new_walk):
            self._goal = question.goal
            if begun:
                # The better plan takes the place of the first.
                del navigator.plans[-2]
            if is_new_walk:
                self._history.begin(navigator)
            self._followed_number = question.number
        elif not begun:
            if not question.fresh:
                # Its way may be blocked, and planning takes longer than a step: think first.
                navigator.halt()
            self.ask(question.goal, fresh=question.fresh)

    def _no_plan(self, question: Question, answer: Answer) -> None:
        refused, goal = answer.plan.goal, question.goal
        on_way = (waypoint for waypoint in self.waypoints if waypoint.pose == refused != goal)
        waypoint = next(on_way, None)
        seen = question.in_the_way if waypoint is None else ""
        text = "no plan: " + (f"{seen} stands there" if seen else answer.plan.reason)
        self.notice = Notice(
            text=text,
            refused=refused,
            alternative=answer.alternative,
            waypoint=waypoint,
            goal=goal,
            narrow_place=answer.plan.narrow_place,
        )
        if not question.fresh:
            # The way that it was on is no more.
            self.navigator.halt()
            self.preview = None
