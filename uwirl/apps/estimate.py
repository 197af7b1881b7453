"""`uwirl-estimate data=readings.csv`: the channel behind a log of readings, how far to trust it, and a map."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from uwirl.apps.program import Program
from uwirl.config.estimate_schema import EstimateConfig

if TYPE_CHECKING:
    from uwirl.runs.survey import Prepared


class Estimate(Program):
    """Estimates from a log, which is read once for the same settings."""

    name = "uwirl-estimate"
    primary = "estimate"
    files = ("data",)
    read: Prepared | None = None

    def prepare(self, config: EstimateConfig, sweep: bool) -> Prepared:
        """All that can be wrong with settings and log, found before a run folder is made."""
        # Imported here so that a typo is answered sooner, and a bad configuration before torch is loaded.
        from uwirl.config.validate import validate_estimate

        validate_estimate(config)
        from uwirl.runs import survey

        if self.read is None or self.read.config != config:
            self.read = survey.prepare(config)
        return self.read

    def run(self, ready: Prepared, folder: Path, sweep: bool, experiment: str, overrides: list[str]) -> dict[str, Any]:
        """Estimate, judge, and draw the map."""
        from uwirl.runs import survey
        from uwirl.study import run_folder

        if not sweep:
            run_folder.check_free(folder, ready.config)
        return survey.run(ready, folder)


def main() -> None:
    """Entry point; see `Program.main`."""
    Estimate().main()


if __name__ == "__main__":
    main()
