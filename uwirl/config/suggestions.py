"""What was probably meant: near names, and one message for whatever Hydra and OmegaConf raise."""

from __future__ import annotations

import dataclasses
import difflib
import re
import typing
from collections.abc import Callable, Iterable, Sequence
from typing import Any

from omegaconf import Container, DictConfig, ListConfig, OmegaConf
from omegaconf.errors import (
    ConfigAttributeError,
    ConfigIndexError,
    ConfigKeyError,
    InterpolationResolutionError,
    MissingMandatoryValue,
    OmegaConfBaseException,
    ValidationError,
)

from uwirl.config.catalogue import field_types, is_schema, keys, words
from uwirl.config.checks import ConfigError

# Hydra and OmegaConf tell which override they stumbled over in their texts only.
OVERRIDE = re.compile(r"(?:Could not override '|Error merging override [+~]*|An item is already at ')([^=']+)")
FILE = re.compile(r"In '([^']+)'")
NOT_FOUND = re.compile(r"Could not (?:find|load) '([^']+)/([^'/]+)'")
LISTED = 24
# Options of Hydra's groups that a plugin brings, and groups that only one has: the extra with it.
EXTRAS = {
    "hydra/launcher/joblib": "sweep",
    "hydra/launcher/submitit_local": "slurm",
    "hydra/launcher/submitit_slurm": "slurm",
    "hydra/launcher/ray": "ray",
    "hydra/launcher/ray_aws": "ray",
    "hydra/sweeper/optuna": "optuna",
    "hydra/sweeper/sampler": "optuna",
}
# Sections that are null until an experiment fills them: OmegaConf then fails with assertions of its own.
FILLED_BY = {"scenario.layouts": "experiment=random_layouts"}


def similar(name: str, names: Iterable[str], most: int = 3) -> list[str]:
    """The nearest of `names`: but for case, then beginnings, then by difflib's ratio."""
    lowered = {candidate.lower(): candidate for candidate in reversed(list(names))}
    name = name.lower()
    if name in lowered:
        return [lowered[name]]
    found = sorted(c for c in lowered if name and (c.startswith(f"{name}_") or name.startswith(f"{c}_")))
    found += difflib.get_close_matches(name, lowered, most, 0.6)
    return [lowered[candidate] for candidate in dict.fromkeys(found)][:most]


def did_you_mean(names: Sequence[str]) -> str:
    return f"; did you mean {' or '.join(repr(name) for name in names)}?" if names else ""


def listed(names: Iterable[str]) -> str:
    """Names in one line, the first few of many."""
    names = list(names)
    return ", ".join(names[:LISTED]) + (", ..." if len(names) > LISTED else "")


def unknown_key(key: str, siblings: Iterable[str], everywhere: Iterable[str] = (), where: str = "") -> ConfigError:
    """A key that no schema has.

    Args:
        key: dotted, as it was given.
        siblings: names that its section has.
        everywhere: dotted names of the whole configuration.
        where: what else there is to say, such as the file in which it stands.
    """
    # A sweeper's space repeats names, misspelt ones too.
    siblings, everywhere = list(siblings), [name for name in everywhere if not name.startswith("hydra.sweeper.params.")]
    section, _, leaf = key.rpartition(".")
    prefix = f"{section}." if section else ""
    # The same name in another section, the nearest section first.
    near = [name for name in everywhere if name.rpartition(".")[2].lower() == leaf.lower()]
    near.sort(key=lambda name: not name.startswith(prefix))
    near += [prefix + name for name in similar(leaf, siblings)]
    near += [] if near else [name for name in everywhere if similar(leaf, [name.rpartition(".")[2]])]
    near += [] if near else difflib.get_close_matches(key, everywhere, 1, 0.6)
    near = list(dict.fromkeys(near))[:3]
    has = f"{section} has" if section else "there are"
    return ConfigError(key, f"no such key{where}{did_you_mean(near)} ({has} {listed(siblings)})")


def check_known(
    config: DictConfig, extra: Iterable[str] = (), prefix: str = "", root: DictConfig | None = None
) -> None:
    """Refuse keys that were added with `+` and that no schema has.

    Args:
        config: composed.
        extra: names of groups, which are no keys but may have been meant.
        prefix, root: where in which configuration, when it calls itself.

    Raises:
        ConfigError: the first of them.
    """
    root = config if root is None else root
    schema = config._metadata.object_type
    known = field_types(schema) if dataclasses.is_dataclass(schema) else None
    for name in map(str, config):
        if known is not None and name not in known:
            everywhere = [key for key in keys(root) if not key.startswith(f"{prefix}{name}")]
            raise unknown_key(f"{prefix}{name}", [*known, *extra], everywhere)
        child = config._get_node(name)
        if known is not None:
            _check_shape(config, name, known[name], f"{prefix}{name}")
        for key, part in _parts(child, f"{prefix}{name}"):
            check_known(part, (), f"{key}.", root)


def _check_shape(config: DictConfig, name: str, annotation: Any, key: str) -> None:
    """OmegaConf takes lists for numbers within a list, and any value for a section that is an interpolation."""
    node = config._get_node(name)
    if isinstance(node, ListConfig) and _filled(node) and set(typing.get_args(annotation)) & {int, float, str}:
        for i in range(len(node)):
            if isinstance(node._get_node(i), (DictConfig, ListConfig)):
                raise ConfigError(f"{key}[{i}]", f"is an entry of a {words(annotation)}, which holds no lists or keys")
    if isinstance(node, Container) and node._is_interpolation():
        value = OmegaConf.select(config, name, throw_on_resolution_failure=False)
        if not (value is None or isinstance(value, Container)):
            raise ConfigError(key, f"must be a {words(annotation)}, but refers to {value!r}")


def _filled(node: Any) -> bool:
    return not (node._is_none() or node._is_missing() or node._is_interpolation())


def _parts(node: Any, key: str) -> list[tuple[str, DictConfig]]:
    """A section, or the sections of a list, that hold keys."""
    if isinstance(node, ListConfig) and _filled(node):
        items = [(f"{key}[{i}]", node._get_node(i)) for i in range(len(node))]
    else:
        items = [(key, node)]
    return [(k, item) for k, item in items if isinstance(item, DictConfig) and _filled(item)]


def explained(
    error: BaseException,
    overrides: Sequence[str] = (),
    extra: Iterable[str] = (),
    holders: Callable[[str], Sequence[str]] = lambda key: (),
) -> ConfigError:
    """What Hydra or OmegaConf raised, as one message.

    Args:
        error: from composing, or from making objects of what was composed.
        overrides: the command line.
        extra: names of groups, which are no keys but may have been meant.
        holders: which options of its group have a key, such as `planner=pd`.
    """
    if isinstance(error, ConfigError):
        return error
    text = str(error).partition("Config search path")[0]
    # Of what it finds in files Hydra keeps the cause as context only.
    causes = (error, error.__cause__, error.__context__)
    cause: Any = next((c for c in causes if isinstance(c, OmegaConfBaseException)), error)
    given = OVERRIDE.search(text)
    key = str(getattr(cause, "full_key", None) or "") or (given[1] if given else "")
    if given and key.split(".")[0].split("[")[0] != given[1].split(".")[0]:
        # The schema of a list's item knows only its own keys.
        key = f"{given[1]}.{key}"
    file = FILE.search(text)
    where = f" (in {file[1]})" if file else ""
    if isinstance(cause, (ConfigAttributeError, ConfigKeyError)) and not isinstance(
        cause, InterpolationResolutionError
    ):
        others = [] if where else holders(key)
        where += f" here, only with {' or '.join(others)}" if others else ""
        return _unknown(cause, key, given[1] if given else key, extra, where)
    if isinstance(cause, ValidationError):
        return _wrong_type(cause, key, given[1] if given else key, overrides, where)
    if isinstance(cause, ConfigIndexError):
        return ConfigError(key, "is beyond the list's entries; set the whole list")
    if isinstance(cause, MissingMandatoryValue):
        return ConfigError(key, f"has no value{where}; give it one with {key}=VALUE")
    if isinstance(cause, InterpolationResolutionError):
        return ConfigError(key, f"refers to what is not there{where}: {first_line(cause)}")
    return _by_text(error, cause, text, key, overrides)


def _by_text(error: BaseException, cause: Any, text: str, key: str, overrides: Sequence[str]) -> ConfigError:
    """What only Hydra's wording tells."""
    if isinstance(cause, (AssertionError, AttributeError)):
        for section, filled in FILLED_BY.items():
            if any(override.lstrip("+~").startswith(section) for override in overrides):
                return ConfigError(section, f"is null here, so none of it can be set; {filled} fills it")
    if "An item is already at" in text:
        return ConfigError(key, f"is there already; drop the +, as in {key}=VALUE")
    missing = NOT_FOUND.search(text)
    if missing:
        group, option = missing.groups()
        there = [line.strip() for line in text.splitlines() if line.startswith("\t")]
        there = [name for name in there if not is_schema(name)]
        extra = EXTRAS.get(f"{group}/{option}") or (None if there else EXTRAS.get(group))
        if extra:
            return ConfigError(group, f"{option!r} needs a plugin, pip install 'uwirl[{extra}]'")
        near = [f"{group}={name}" for name in similar(option, there)]
        # Where it was asked for Hydra does not say.
        if there:
            return ConfigError(group, f"{option!r} is none of {listed(there)}{did_you_mean(near)}")
    return ConfigError(key or "configuration", one_line(error))


def _unknown(cause: Any, key: str, given: str, extra: Iterable[str], where: str) -> ConfigError:
    parent = cause.parent_node
    if isinstance(parent, DictConfig) and parent._metadata.object_type is dict:
        # Names that no schema lists, such as settings of a class of the user's own.
        return ConfigError(given, f"is not there yet; add it with a +, as in +{given}=VALUE")
    siblings = [str(name) for name in parent if name != "hydra"] if isinstance(parent, DictConfig) else []
    root = parent._get_root() if parent is not None else None
    everywhere = list(keys(root)) if isinstance(root, DictConfig) and root is not parent else []
    if root is parent and isinstance(parent, DictConfig) and "[" not in key and "." not in key:
        everywhere = list(keys(parent))
        siblings = list(dict.fromkeys([*siblings, *extra]))
    error = unknown_key(key, siblings, everywhere, where)
    if given.startswith(f"{key}.") and siblings:
        # `chanel.n`: the section is misspelt, the rest of the key may be right.
        whole = [f"{name}{given.removeprefix(key)}" for name in similar(key, siblings)]
        right = [name for name in whole if name in everywhere]
        if right:
            return ConfigError(given, f"no such key{where}{did_you_mean(right)} (there are {listed(siblings)})")
    return error


def _wrong_type(cause: Any, key: str, given: str, overrides: Sequence[str], where: str) -> ConfigError:
    parent, section = cause.parent_node, cause.object_type
    if isinstance(parent, ListConfig):
        # An entry set by its number; a list that is set as a whole is still being filled here.
        if given.count(".") > key.count(".") and int(cause.key) >= len(parent):
            return ConfigError(key, f"is beyond the list's {len(parent)} entries; set the whole list")
        return ConfigError(key, f"is an entry of a {words(cause.ref_type)}: {first_line(cause)}{where}")
    known = field_types(section) if isinstance(section, type) and dataclasses.is_dataclass(section) else {}
    wanted = known.get(str(cause.key))
    if wanted is None:
        return ConfigError(key, first_line(cause) + where)
    if dataclasses.is_dataclass(wanted):
        return ConfigError(key, f"is a group of settings, which takes no single value; set {key}.KEY=VALUE{where}")
    rule = f"must be {'' if wanted is bool else 'a '}{words(wanted)}"
    if given.startswith(f"{key}."):
        return ConfigError(given, f"no such key: {key} is no group of settings, it {rule}")
    value = next((o.partition("=")[2] for o in overrides if o.lstrip("+").partition("=")[0] == key), None)
    got = "" if value is None else f", got {value or 'nothing'}"
    return ConfigError(key, f"{rule}{got}{where}")


def first_line(error: BaseException) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0].strip()


def one_line(error: BaseException) -> str:
    """The message, with the first line of what caused it, which is where Hydra puts the reason."""
    text = str(error).partition("Config search path")[0]
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    cause = str(error.__cause__).splitlines()[:1] if error.__cause__ else []
    return "; ".join(lines + [line for line in cause if line not in lines])
