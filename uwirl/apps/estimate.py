"""`uwirl-estimate data=readings.csv`: the channel behind a log of readings, how far to trust it, and a map."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from uwirl.apps.command_line import answer, launch, say
from uwirl.apps.job import in_folder
from uwirl.config import compose
from uwirl.config.estimate_rules import validate_estimate
from uwirl.config.estimate_schema import EstimateConfig, register
from uwirl.config.suggestions import check_known

if TYPE_CHECKING:
    from uwirl.runs.survey import Survey


def main() -> None:
    """Entry point. Exits 2, with one message and no run folder, on a bad configuration or log; 1 if the run failed."""
    register()
    checked: list[Survey] = []
    answer("uwirl-estimate", "estimate", lambda composed: checked.append(_prepare(_typed(composed))))
    launch("uwirl-estimate", "estimate", lambda composed: in_folder("uwirl-estimate", partial(_job, composed, checked)))


def _job(composed: DictConfig, checked: list[Survey], folder: Path, sweep: bool) -> dict[str, Any]:
    """Run one job in its folder, on a log that may have been read already; returns what metrics.json holds."""
    from uwirl.runs.refusal import write_refusal
    from uwirl.runs.survey import run
    from uwirl.study import run_folder

    config = None
    try:
        if not checked:
            check_known(composed)
            config = _typed(composed)
        survey = checked.pop() if config is None else _prepare(config)
    except (ValueError, OSError) as error:
        say("uwirl-estimate", error)
        return write_refusal(folder, "estimate", list(HydraConfig.get().overrides.task), config, error)
    if not sweep:
        run_folder.check_free(folder, survey.config)
    return run(survey, folder)


def _typed(composed: DictConfig) -> EstimateConfig:
    config = compose.to_object(composed)
    assert isinstance(config, EstimateConfig)
    return config


def _prepare(config: EstimateConfig) -> Survey:
    """All that can be wrong with settings and log, found before a run folder is made.

    Raises:
        ValueError, OSError: with what is wrong.
    """
    validate_estimate(config)
    # Imported here so that a bad configuration is answered before torch is loaded.
    from uwirl.runs.survey import Survey

    return Survey.of(config)


if __name__ == "__main__":
    main()
