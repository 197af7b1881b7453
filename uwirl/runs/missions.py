"""Missions on the true channel: the one of the scenario, or one in each of many random layouts."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from uwirl import build
from uwirl.algorithm import Estimated
from uwirl.config.motion_schema import GeodesicConfig
from uwirl.config.schema import Config, IrlConfig
from uwirl.motion.features import MotionBasis
from uwirl.motion.guidance import is_open
from uwirl.motion.learning import IterationRecord, Learning, LearningState
from uwirl.motion.planner import fitted
from uwirl.runs import pictures
from uwirl.runs.recorded import warn
from uwirl.snr.estimate import ChannelEstimate
from uwirl.study import run_files, shadowing
from uwirl.study.campaign import fly
from uwirl.study.evaluation import Evaluation
from uwirl.study.mission_table import table
from uwirl.study.tensorboard import TensorBoard
from uwirl.study.warnings import campaign_warnings, flight_warnings
from uwirl.world.agent import Agent
from uwirl.world.chunks import at_once
from uwirl.world.relay import Relay
from uwirl.world.trajectory import Trajectory

log = logging.getLogger("uwirl")

# Number of worlds flown as one batch; their trajectories take about 100 MB.
BATCH = 250
# Number of iterates flown again, spread evenly over the learning: more would not show more.
FLOWN_AGAIN = 40


@dataclass(frozen=True)
class Course:
    """How a policy was learned.

    Attributes:
        records: the policy iterations.
        costs: J of each iterate, None for those that were not flown again.
        basis: gives the weights their names.
        converged: whether learning converged.
    """

    records: Sequence[IterationRecord]
    costs: Sequence[float | None]
    basis: MotionBasis
    converged: bool


class MissionFlight:
    """Flies the mission of the scenario and reports it.

    Args:
        config: configuration of the run.
        env: the world of the mission.
        folder: folder of the run.
    """

    def __init__(self, config: Config, env: Relay, folder: Path):
        self.config, self.env, self.folder = config, env, folder
        self.evaluator = build.make_evaluator(config, env)

    @property
    def has_routes(self) -> bool:
        """Whether the vehicle flies along routes, and not straight."""
        return isinstance(self.config.guidance, GeodesicConfig) and not is_open(self.env.scenario)

    def fly(self, agents: dict[str, Agent]) -> dict[str, Evaluation]:
        """The missions of agents by their names, flown as one batch."""
        flown = self.evaluator.fly_side_by_side([(agent, 1) for agent in agents.values()])
        return dict(zip(agents, flown, strict=True))

    def first(self, legs: Sequence[Trajectory]) -> dict[str, Evaluation]:
        """The first mission, flown while learning, by its name in the table; nothing if it is not whole."""
        steps = self.env.scenario.steps
        whole = [leg for leg in legs if leg.first_step < steps]
        if sum(len(leg.tau) for leg in whole) != steps:
            return {}
        return {"first mission": self.evaluator.judge(Trajectory.joined(whole))}

    def baseline(self, estimate: ChannelEstimate) -> dict[str, Agent]:
        """The baseline planner's agent, by its name."""
        planner = build.make_planner(self.config, self.config.baseline, self.env)
        return {self.config.baseline.name: fitted(planner, self.env, estimate)}

    def fly_learned(
        self,
        learning: Learning,
        state: LearningState,
        records: Sequence[IterationRecord],
        estimate: ChannelEstimate,
    ) -> tuple[dict[str, Evaluation], list[float | None]]:
        """The missions of start policy, baseline and learned policy, flown as one batch with the iterates.

        Returns:
            Missions by the name of their planner, and J of each iterate, None for those that are not flown again.
        """
        count, vehicles = len(records), self.env.scenario.vehicles
        again = torch.linspace(0, count - 1, min(count, FLOWN_AGAIN)).round().long().tolist()
        iterates, final = [records[k].actor for k in again], state.learner.actor
        # Iterates fly by what was known of the vehicle at their time.
        early = sum(not records[k].modelled for k in again)
        ((name, baseline),) = self.baseline(estimate).items()
        agents = [(baseline, 1)]
        for known, actors in ((None, [state.start, *iterates[:early]]), (state.known, [*iterates[early:], final])):
            weights = torch.stack([w[:vehicles] for w in actors])
            agents.append((self.evaluator.agent_of_weights(learning, weights, state.trim, known), len(weights)))
        pair, start, *flown, learned = self.evaluator.fly_side_by_side(agents, [1] * (3 + len(iterates)))
        costs: list[float | None] = [None] * count
        for k, evaluation in zip(again, flown, strict=True):
            costs[k] = float(evaluation.cost[0])
        return {"start policy": start, name: pair, self.config.planner.name: learned}, costs

    def settled(self, evaluation: Evaluation) -> bool:
        """Whether 1/C changes by less than epsilon_4 over the last window of the mission."""
        planner = self.config.planner
        assert isinstance(planner, IrlConfig)
        inverse = 1.0 / evaluation.chain_capacity[:, 0]
        window = round(planner.window_s / evaluation.trajectory.dt)
        return float((inverse[-1] - inverse[-1 - window]).abs()) < planner.tolerance_inverse_capacity

    def report(
        self,
        flown: dict[str, Evaluation],
        stage_1: Estimated,
        board: TensorBoard | None = None,
        course: Course | None = None,
    ) -> dict[str, Any]:
        """Write trajectory and figures of a mission, and log a table of several.

        Args:
            flown: evaluations by the name of their planner; the last one is the mission of the run.
            stage_1: readings and channel estimate.
            board: None for none.
            course: how the last one was learned; None without learning.

        Returns:
            Entries of metrics.json.
        """
        evaluation = list(flown.values())[-1]
        trajectory, targets = evaluation.trajectory, self.evaluator.mission.targets
        messages = shadowing.messages(self.env, trajectory)
        run_files.write_trajectory(self.folder, evaluation, messages)
        if board is not None:
            board.evaluation(evaluation, messages)
        if pictures.wanted(self.config.logging):
            self._draw(flown, messages, board, course)
        for line in table(flown, None if course is None else course.converged):
            log.info("%s", line)
        shadowed = shadowing.summary(self.env, trajectory, targets, stage_1.readings, stage_1.estimate)
        for sentence in flight_warnings(self.env.scenario, evaluation):
            warn(sentence)
        return evaluation.metrics() | shadowed

    def _draw(
        self,
        flown: dict[str, Evaluation],
        messages: shadowing.LinksAtMessages,
        board: TensorBoard | None,
        course: Course | None,
    ) -> None:
        from uwirl.study import animation, learning_figure, mission_figures

        *others, (_, evaluation) = flown.items()
        drawn = {
            "mission": mission_figures.mission_figure(self.env.scenario, evaluation, messages),
            "motion": mission_figures.motion_figure(evaluation, self.env.vehicle.tau_max),
        }
        if course is not None:
            costs = {name: float(other.cost[0]) for name, other in others}
            drawn["learning"] = learning_figure.learning_figure(course.records, course.costs, costs, course.basis)
        for name, figure in drawn.items():
            picture = pictures.save(figure, self.folder, name)
            if board is not None:
                board.picture(picture)
        if self.config.logging.animation:
            film = self.folder / "figures" / "mission.gif"
            animation.save(self.env.scenario, evaluation, film)
            log.info("animation: %s", film)


def campaign(config: Config, agent_in: Callable[[Relay], Agent], folder: Path) -> dict[str, Any]:
    """Fly every layout of `scenario.layouts`; write layouts.npz and the figure.

    Args:
        config: configuration with `scenario.layouts`.
        agent_in: returns the agent for given worlds.
        folder: folder of the run.

    Returns:
        Entries of metrics.json.
    """
    worlds, layouts = build.make_layouts(config)
    shown: list[tuple[Relay, Evaluation]] = []
    flown = 0

    def watch(some: Relay, evaluation: Evaluation) -> None:
        nonlocal flown
        flown += some.worlds
        log.info("  flown: %d of %d layouts", flown, len(layouts.kind))
        if not shown:
            shown.append((some, evaluation))

    batch = at_once(BATCH, layouts.kind.device)
    outcomes = fly(worlds, layouts, agent_in, build.make_evaluator(config, worlds), batch, watch)
    for line in outcomes.table():
        log.info("%s", line)
    run_files.write_layouts(folder, layouts, outcomes)
    if pictures.wanted(config.logging):
        from uwirl.study.layouts_figure import layouts_figure

        pictures.save(layouts_figure(*shown[0], layouts.kind), folder, "layouts")
    for sentence in campaign_warnings(outcomes):
        warn(sentence)
    return outcomes.metrics()
