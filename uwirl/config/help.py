"""`uwirl --help`: groups with their options, and how to override. Hydra's own would list schemas as options too."""

from __future__ import annotations

import textwrap

from hydra.core.config_loader import ConfigLoader

from uwirl.config.groups import chosen, load, options

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


def help_text(program: str, name: str, loader: ConfigLoader) -> str:
    """What --help prints, of the program with this primary configuration."""
    defaults = chosen(loader, name)
    width = max(map(len, defaults)) + 2
    rows = []
    for group, default in defaults.items():
        there = options(loader, group.partition("@")[0])
        listed = ", ".join(f"*{option}" if option == default else option for option in there)
        indent = " " * (width + 2)
        rows.append(textwrap.fill(listed, 100, initial_indent=f"  {group:{width}}", subsequent_indent=indent))
    primary = load(loader, name)
    assert primary is not None
    keys = ", ".join(
        f"{key}.*" if hasattr(primary._get_node(key), "keys") else key
        for key in map(str, primary)
        if key not in ("defaults", "hydra")
    )
    return TEXT.format(
        program=program, purpose=PURPOSE[program], groups="\n".join(rows), keys=keys, example=EXAMPLE[program]
    )
