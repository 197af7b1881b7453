"""`uwirl --help`: groups with their options, and how to override. Hydra's own would list schemas as options too."""

from __future__ import annotations

import textwrap
from typing import Any

from omegaconf import OmegaConf

from uwirl.config.groups import Groups

TEXT = """\
{program}: {purpose}

{program} [GROUP=OPTION ...] [KEY=VALUE ...]

Groups and their options (* is the default):
{groups}

Settings outside groups: {keys}

  {example}
docs/configuration.md lists every key with its unit.

  key=null  key=[1,2]  'key="a, b"'    values; quote what the shell would take apart
  --multirun key=1,2,3 group=a,b       one job for each combination
  --config-dir FOLDER                  options of your own, as FOLDER/GROUP/OPTION.yaml
  --cfg job                            print the configuration, run nothing
  --hydra-help                         Hydra's own flags
"""
PURPOSE = {
    "uwirl": "estimate the fading channel, plan where to relay, and fly there",
    "uwirl-evaluate": "fly what was learned, without learning; checkpoint=PATH says what, overrides say where",
    "uwirl-estimate": "the channel behind a log of SNR readings, how far to trust it, and a map",
}
EXAMPLE = {
    "uwirl": "uwirl channel=acoustic_24khz scenario.start=[[5,5,-6,0]] seed=3",
    "uwirl-evaluate": "uwirl-evaluate checkpoint=outputs/fig5_single/DATE vehicle=bluerov2_heavy",
    "uwirl-estimate": "uwirl-estimate data=readings.csv channel.frequency_khz=12",
}


def help_text(program: str, groups: Groups) -> str:
    """What --help prints, of the program with these groups."""
    width = max(map(len, groups.defaults)) + 2
    rows = []
    for group, default in groups.defaults.items():
        options = ", ".join(f"*{option}" if option == default else option for option in groups.options(group))
        indent = " " * (width + 2)
        rows.append(textwrap.fill(options, 100, initial_indent=f"  {group:{width}}", subsequent_indent=indent))
    primary: Any = OmegaConf.to_container(groups.load(groups.name) or OmegaConf.create())
    names = [f"{key}.*" if isinstance(value, dict) else key for key, value in primary.items()]
    keys = ", ".join(name for name in names if name not in ("defaults", "hydra.*"))
    listed = "\n".join(rows)
    return TEXT.format(program=program, purpose=PURPOSE[program], groups=listed, keys=keys, example=EXAMPLE[program])
