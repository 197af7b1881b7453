"""Classes of the user's own: what is refused, in one message, and what is let through."""

from __future__ import annotations

import pkgutil
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from uwirl.config.checks import ConfigError
from uwirl.config.compose import compose
from uwirl.config.custom import FAMILIES, misfit
from uwirl.config.validate import validate
from uwirl.study.run_folder import config_hash

MODULE = """
from uwirl.motion.planner import Planner
from uwirl.world.acoustics import Channel, LinkBudget
from uwirl.world.vehicle import Vehicle

class Whole:
    def __init__(self, gain=1.0):
        self.gain = gain
    def fit(self, env, estimate):
        return lambda state, step: None

class Anything(Whole):
    def __init__(self, **settings):
        super().__init__()

class Ours(Vehicle):
    def __init__(self, dead_zone=0.0, **parameters):
        super().__init__(**parameters)

class Modem(LinkBudget): ...

class Water(Channel): ...

class Stub(Planner): ...

class Needy(Whole):
    def __init__(self, gain):
        super().__init__(gain)

class Steady(Whole):
    def __init__(self, guard, cost):
        super().__init__()

class Nothing: ...

class Attribute:
    fit = 3

class Short:
    def fit(self, env): ...

class Callable:
    def __call__(self, readings, budget): ...

class Half:
    def tau_max(self): ...
    def saturate(self, tau): ...
    def step(self, state, tau, dt): ...

def function(readings, budget, n=2.0): ...
def reader(readings): ...

number = 3
"""
PLANNER = "planner=custom planner.target=mine."
ESTIMATOR = "estimator=custom estimator.target=mine."
REFUSED = [
    ("planner=custom", "planner.target", "names no class of yours; give package.module.Class"),
    ("planner=own", "planner.target", "names no class of yours; give package.module.Class"),
    ("planner=own planner.target=Whole", "planner.target", "must be package.module.Class, got 'Whole'"),
    ("planner=own planner.target=mine.", "planner.target", "must be package.module.Class"),
    ("planner=own 'planner.target=my file.Whole'", "planner.target", "must be package.module.Class"),
    ("planner=own planner.target=nowhere.Whole", "planner.target", "no module 'nowhere', neither installed nor in "),
    ("planner=own planner.target=mine.deeper.Whole", "planner.target", "no module 'mine.deeper'"),
    ("planner=own planner.target=broken.Whole", "planner.target", "broken cannot be imported: ZeroDivisionError"),
    ("planner=own planner.target=lacking.Whole", "planner.target", "lacking cannot be imported: ModuleNotFoundError"),
    (f"{PLANNER}Whol", "planner.target", "mine has no 'Whol'; did you mean 'mine.Whole'?"),
    (f"{PLANNER}number", "planner.target", "mine.number is no class"),
    (f"{PLANNER}function", "planner.target", "mine.function is no class"),
    (f"{PLANNER}Nothing", "planner.target", "is no uwirl.motion.planner.Planner: it has no fit(env, estimate)"),
    (f"{PLANNER}Stub", "planner.target", "is no uwirl.motion.planner.Planner: it has no fit(env, estimate)"),
    (f"{PLANNER}Attribute", "planner.target", "it has no fit(env, estimate)"),
    (f"{PLANNER}Short", "planner.target", "fit(env, estimate) cannot be called so: too many positional arguments"),
    (f"{PLANNER}Needy", "planner.settings", "missing a required argument: 'gain'"),
    (f"{PLANNER}Whole +planner.settings.gian=2", "planner.settings.gian", "did you mean 'planner.settings.gain'?"),
    (f"{PLANNER}Whole +planner.settings.x=2", "planner.settings.x", "mine.Whole takes gain"),
    (f"{PLANNER}Whole planner.settings.gain=2", "planner.settings.gain", "add it with a +"),
    (f"{PLANNER}Whole planner.calibration_s=2", "planner.calibration_s", "only with planner=identified or planner=irl"),
    ("planner.target=mine.Whole", "planner.target", "only with planner=custom"),
    ("baseline.target=mine.Whole", "baseline.target", "only with planner@baseline=custom"),
    ("solver.target=mine.Whole", "solver.target", "is a class of yours, which stands in channel, vehicle, estimator,"),
    ("planner@baseline=own baseline.target=mine.Short", "baseline.target", "cannot be called so"),
    (f"{ESTIMATOR}Nothing", "estimator.target", "it has no __call__(readings, budget)"),
    (f"{ESTIMATOR}number", "estimator.target", "is no class and no function"),
    (f"{ESTIMATOR}reader", "estimator.settings", "too many positional arguments"),
    (f"{ESTIMATOR}function +estimator.settings.m=2", "estimator.settings.m", "mine.function takes n"),
    (f"{ESTIMATOR}function +estimator.settings.budget=2", "estimator.settings.budget", "mine.function takes n"),
    ("basis=own basis.target=mine.Nothing", "basis.target", "is no uwirl.motion.features.MotionBasis: it has no "),
    ("vehicle.target=mine.Half", "vehicle.target", "step(state, tau, dt, current, out) cannot be called so"),
    ("vehicle.target=mine.Nothing", "vehicle.target", "is no uwirl.world.vehicle.Dynamics: it has no saturate(tau)"),
    ("+vehicle.settings.gain=2", "vehicle.settings", "are those of vehicle.target, which names no class"),
    (
        "vehicle.target=mine.Ours +vehicle.settings.ded_zone=2",
        "vehicle.settings.ded_zone",
        "settings.dead_zone'?",
    ),
    ("estimator=own estimator.target=builtins.iter", "estimator.target", "builtins.iter does not tell what it takes"),
    ("planner=own planner.target=leaving.X", "planner.target", "leaving cannot be imported: SystemExit: 0"),
    ("channel.target=mine.Nothing", "channel.target", "is no uwirl.world.acoustics.LinkBudget: it must be a subclass"),
    (
        "vehicle.target=mine.Ours +vehicle.settings.mass_kg=2",
        "vehicle.settings.mass_kg",
        "is no setting of the class alone; set mass_kg outside settings",
    ),
    (
        "planner=trajectory_optimization vehicle.target=mine.Ours",
        "planner.name",
        "plans with the equations of uwirl's own vehicle",
    ),
    (
        "planner@baseline=trajectory_optimization channel.target=mine.Modem",
        "baseline.name",
        "plans with the equations of uwirl's own channel",
    ),
]
ACCEPTED = [
    f"{PLANNER}Whole",
    f"{PLANNER}Whole planner.name=whole",
    f"{PLANNER}Needy +planner.settings.gain=2",
    f"{PLANNER}Anything +planner.settings.whatever=[1,2]",
    f"{PLANNER}Whole planner@baseline=own baseline.target=mine.Whole",
    f"{ESTIMATOR}Callable",
    f"{ESTIMATOR}function +estimator.settings.n=1.5",
    "vehicle.target=uwirl.world.vehicle.Vehicle",
    "vehicle.target=mine.Ours +vehicle.settings.dead_zone=2",
    "channel.target=uwirl.world.acoustics.Channel",
    "channel.target=mine.Modem",
    "channel.target=mine.Water",
    f"{PLANNER}Steady",
    "vehicle.target=null",
    "planner=own planner.target=mine.Whole",
]


@pytest.mark.parametrize("first", ["", "defaults: [own_schema]\n"], ids=["plain", "with the schema it once needed"])
def test_a_file_is_all_that_it_takes(tmp_path, first):
    (tmp_path / "conf" / "planner").mkdir(parents=True)
    option = f"{first}name: needy\ntarget: mine.Needy\nsettings: {{gain: 2}}\n"
    (tmp_path / "conf" / "planner" / "needy.yaml").write_text(option)
    config = compose(["planner=needy"], "conf")
    validate(config)
    assert (config.planner.name, config.planner.settings) == ("needy", {"gain": 2})


PROTOCOLS = {schema.family: family.protocol for schema, family in FAMILIES.items()}


@pytest.fixture(autouse=True)
def modules(tmp_path, monkeypatch):
    (tmp_path / "mine.py").write_text(MODULE)
    (tmp_path / "broken.py").write_text("1 / 0")
    (tmp_path / "leaving.py").write_text("import sys; sys.exit(0)")
    (tmp_path / "lacking.py").write_text("import something_else")
    monkeypatch.setattr(sys, "path", sys.path.copy())
    monkeypatch.chdir(tmp_path)
    yield
    sys.modules.pop("mine", None)


@pytest.mark.parametrize(("overrides", "key", "told"), REFUSED, ids=[row[0] for row in REFUSED])
def test_what_does_not_fit_is_refused(overrides, key, told):
    with pytest.raises(ConfigError) as caught:
        validate(compose(shlex.split(overrides)))
    assert str(caught.value).startswith(f"{key}: ")
    assert told in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("overrides", ACCEPTED)
def test_what_fits_is_accepted(overrides):
    validate(compose(shlex.split(overrides)))


@pytest.mark.parametrize(
    ("key", "path"),
    [
        ("channel", "uwirl.world.acoustics.LinkBudget"),
        ("vehicle", "uwirl.world.vehicle.Vehicle"),
        ("basis", "uwirl.motion.features.ErrorBasis"),
        ("basis", "uwirl.motion.features.LinkFrameBasis"),
        ("basis", "uwirl.motion.geodesic_basis.GeodesicBasis"),
        ("planner", "uwirl.motion.irl_planner.IrlPlanner"),
        ("planner", "uwirl.baselines.pd.PdPlanner"),
        ("planner", "uwirl.baselines.potential_field.PotentialField"),
        ("planner", "uwirl.baselines.trajectory_optimization.TrajectoryOptimization"),
    ],
)
def test_what_is_ours_is_one_of_its_family(key, path):
    assert misfit(pkgutil.resolve_name(path), pkgutil.resolve_name(PROTOCOLS[key])) is None


def test_the_hash_covers_class_and_settings():
    one, other, faster = (
        config_hash(compose(shlex.split(f"planner=own planner.target={rest}")))
        for rest in ("mine.Whole", "mine.Anything", "mine.Whole +planner.settings.gain=2")
    )
    assert len({one, other, faster}) == 3


def test_a_configuration_without_targets_imports_no_torch():
    code = "import sys; from uwirl.config.compose import compose; from uwirl.config.validate import validate;"
    code += "validate(compose()); assert 'torch' not in sys.modules"
    root = str(Path(__file__).parents[2])
    subprocess.run([sys.executable, "-c", code], check=True, cwd=root)
