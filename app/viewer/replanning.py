"""Leads the robot where people command: asks the planner for ways, and has the answers followed."""

from __future__ import annotations

import time
from dataclasses import dataclass

from app.viewer.live_navigator import LiveNavigator, ReplanPoint
from app.viewer.planner_process import Answer, PlannerProcess
from app.viewer.snapshot import Notice, WalkHistory
from planner.plan import FootstepPlan, Pose, finite_pose


@dataclass(frozen=True, kw_only=True)
class Question:
    """What the planner was asked, from which moment, and for which goal.

    fresh: somebody has set this goal; otherwise it is the way to the old one that is asked for.
    in_the_way: what was seen at the goal already when it was pointed at.
    """

    number: int
    replan_point: ReplanPoint
    goal: Pose
    fresh: bool
    asked_s: float
    in_the_way: str = ""


class Replanner:
    """Asks for one robot at a time, the `navigator`; used from one thread.

    `notice` is what there is to be told of. `answer_s` is the real time that the last question took
    until its first answer, and `answer_of` that question's number.
    """

    def __init__(
        self, planner: PlannerProcess, history: WalkHistory, navigator: LiveNavigator
    ) -> None:
        self._planner, self._history = planner, history
        self.answer_of = self._followed_number = -1
        self.take(navigator)

    def take(self, navigator: LiveNavigator) -> None:
        """Leads this robot from now on; whatever was asked for another one is forgotten."""
        self.navigator = navigator
        self.question: Question | None = None
        self.notice: Notice | None = None
        self.preview: FootstepPlan | None = None
        self.answer_s: float | None = None
        self._history.begin(navigator)

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
        number = self._planner.ask(
            goal=goal, start_feet_world=replan_point.feet_world, first_side=replan_point.first_side
        )
        self.question = Question(
            number=number,
            replan_point=replan_point,
            goal=goal,
            fresh=fresh,
            asked_s=time.monotonic(),
            in_the_way=in_the_way,
        )

    def listen(self) -> None:
        """Takes the answers that have come."""
        for answer in self._planner.answers() if self.question else []:
            question = self.question
            if question is not None and answer.number == question.number:
                self._answered(question, answer)

    def ticked(self) -> None:
        """Sees to it that the question is still asked after each moment of the robot."""
        if self.question is not None and self.question.number != self._planner.number:
            # The navigator asked in between, when its wait was over, and got its answer.
            self._ask_again(self.question)

    def plan_anew(self) -> None:
        """What was asked is asked again, and what is walked is planned again."""
        navigator = self.navigator
        if self.question is not None:
            self._ask_again(self.question)
        elif navigator.going and not (navigator.halted or navigator.has_ended):
            self.ask(finite_pose(navigator.goal), fresh=False)

    def stop(self) -> None:
        """Has the robot stand still as soon as possible."""
        self.question = self.preview = None
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
        if navigator.go(question.goal, plan, question.replan_point, fresh=is_new_walk):
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
        seen, reason = question.in_the_way, answer.plan.reason
        text = f"no plan: {seen} stands there" if seen else f"no plan: {reason}"
        self.notice = Notice(text=text, refused=question.goal, alternative=answer.alternative)
        if not question.fresh:
            # The way that it was on is no more.
            self.navigator.halt()
            self.preview = None
