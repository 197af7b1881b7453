"""Every rule of `uwirl.config.validate`: what breaks it, the key it names and what it says; and what just passes."""

from __future__ import annotations

import re

import pytest

from uwirl.config.cautions import cautions
from uwirl.config.compose import compose
from uwirl.config.groups import parsed
from uwirl.config.validate import RK4_STABILITY, ConfigError, validate

PAIR = "scenario.start=[[0,0,-5,0],[5,5,-5,0]]"
SHORT_LINK = "scenario.source_m=[0,0,-8] scenario.destination_m=[2,0,-8] scenario.vehicle_radius_m=0.35"
HOVER_AND_LEG = "planner.calibration_s=15 experience.leg_s=5 planner.max_time_s"
CYLINDER = "scenario.obstacles=[{{center_m:{},radius_m:{},influence_m:6}}]"
PARALLEL = "experience=parallel"
SENSORS = "scenario.sensors=[[0,0,-8],[5,0,-8],{}]"

RULES = [
    # where runs start from
    ("checkpoint.every=0", "checkpoint.every", "must be at least 1, got 0"),
    ("resume=''", "resume", "names no checkpoint"),
    ("init_from=''", "init_from", "names no checkpoint"),
    ("init_from_parts=[weight]", "init_from_parts", "did you mean 'weights'?"),
    ("init_from_parts=[]", "init_from_parts", "needs one or both of estimate, weights"),
    ("init_from=a.pt planner=pd", "init_from_parts", "planner=pd has no weights; choose [estimate]"),
    # scenario
    ("scenario.source_m=[0,0]", "scenario.source_m", "needs 3 finite numbers, got [0.0, 0.0]"),
    ("scenario.source_m=[0,0,nan]", "scenario.source_m", "needs 3 finite numbers"),
    ("scenario.destination_m=[0,0,-8,1]", "scenario.destination_m", "needs 3 finite numbers"),
    ("scenario.destination_m=[-30,-30,-8]", "scenario.destination_m", "coincides with scenario.source_m"),
    ("scenario.source_m=[0,0,1]", "scenario.source_m", "is not in the water, -20 <= z <= 0"),
    ("scenario.start=[[1,2,-21,0]]", "scenario.start", "is not in the water"),
    ("scenario.depth_m=0", "scenario.depth_m", "must be greater than 0"),
    ("scenario.start=[[0,0,-5,0],[0.5,0,-5,0]]", "scenario.start.1", "is closer than safety.separation_m = 1 m to"),
    ("scenario.current_mps=[0.1]", "scenario.current_mps", "needs 3 finite numbers"),
    ("scenario.current_mps=[2,0,0]", "scenario.current_mps", "more than vehicle.tau_max can hold against"),
    ("scenario.current_std_mps=-1", "scenario.current_std_mps", "must be at least 0"),
    ("scenario.current_time_s=0", "scenario.current_time_s", "must be greater than 0"),
    ("scenario.current_mps=[0.5,0,0]", "safety.brake_force_N", "that weight and current leave for braking"),
    ("scenario.detection_range_m=0", "scenario.detection_range_m", "must be greater than 0"),
    ("scenario.detection_range_m=1", "scenario.detection_range_m", "m in which 2.46 m/s is braked"),
    ("cost=paper cost.right_m=5", "cost.left_m", "must lie between 0 and right_m = 5"),
    ("cost=paper cost.kappa_2=0.95", "cost.kappa_1", "needs 0 < kappa_2 < kappa_1 < 1"),
    ("experiment=random_layouts scenario.layouts.count=0", "scenario.layouts.count", "must be at least 1"),
    ("experiment=random_layouts scenario.layouts.seed=-1", "scenario.layouts.seed", "must lie in [0, 2^63)"),
    ("experiment=random_layouts scenario.layouts.kinds=[]", "scenario.layouts.kinds", "needs at least one of sparse"),
    ("experiment=random_layouts scenario.layouts.kinds=[rings]", "scenario.layouts.kinds", "did you mean 'ring'"),
    ("experiment=random_layouts scenario.layouts.half_width_m=0", "scenario.layouts.half_width_m", "greater than 0"),
    ("experiment=random_layouts scenario.layouts.current_mps=-1", "scenario.layouts.current_mps", "at least 0"),
    ("basis=geodesic", "experience.relabel", "another link needs another map"),
    ("basis=geodesic guidance=straight", "guidance.name", "learns how to fly with guidance=geodesic"),
    (
        "basis=geodesic experience=mission experience.relabel=0",
        "experience.name",
        "learns from experience=virtual_links",
    ),
    ("scenario.start=[]", "scenario.start", "needs at least one vehicle [x, y, z, psi]"),
    ("scenario.start=[1,2,-3,0]", "scenario.start.0", "needs 4 finite numbers, got 1"),
    (f"{PAIR} {SHORT_LINK}", "scenario.start", "targets of 2 vehicles 0.667 m apart on the link of 2 m, closer than"),
    (f"safety=none {PAIR} {SHORT_LINK}", "scenario.start", "= 0.7 m; 1 would fit"),
    ("scenario.start=[[1,2,-3]]", "scenario.start.0", "needs 4 finite numbers"),
    ("scenario.start=[[0,0,-5,0],[1,2,inf,0]]", "scenario.start.1", "needs 4 finite numbers"),
    ("scenario.start=[[1,2,-3,east]]", "scenario.start.0", "needs 4 finite numbers"),
    ("scenario.start=[[-30,-30,-8,1]]", "scenario.start.0", "coincides with the source"),
    ("scenario.start=[[30,30,-8,1]]", "scenario.start.0", "coincides with the destination"),
    ("scenario.start=[[0,0,-5,0],[0,0,-5,1]]", "scenario.start.1", "coincides with vehicle 0"),
    ("scenario.dt_s=0", "scenario.dt_s", "must be greater than 0, got 0"),
    ("scenario.dt_s=inf", "scenario.dt_s", "must be greater than 0, got inf"),
    ("scenario.duration_s=-80", "scenario.duration_s", "must be greater than 0, got -80"),
    ("scenario.duration_s=0.02", "scenario.duration_s", "0.02 s is shorter than 1 steps"),
    ("scenario.duration_s=80.02", "scenario.duration_s", "80.02 s is no whole number of steps"),
    ("scenario.hearing_range_m=0", "scenario.hearing_range_m", "must be greater than 0, got 0"),
    ("scenario.hearing_range_m=nan", "scenario.hearing_range_m", "must be greater than 0, got nan"),
    ("scenario.message_period_s=0", "scenario.message_period_s", "must be greater than 0, got 0"),
    ("scenario.message_period_s=0.52", "scenario.message_period_s", "0.52 s is no whole number of steps"),
    ("scenario.message_period_s=0.02", "scenario.message_period_s", "0.02 s is shorter than 1 steps"),
    ("scenario.sensors=2", "scenario.sensors", "2 sensors cannot determine K, n and the fading"),
    ("scenario.sensors=16.5", "scenario.sensors", "must be a number or a list of positions"),
    ("scenario.sensors=true", "scenario.sensors", "must be a number or a list of positions"),
    ("scenario.sensors=[[0,0,-8],[5,0,-8]]", "scenario.sensors", "2 sensors cannot determine"),
    (SENSORS.format("[1,2]"), "scenario.sensors.2", "needs 3 finite numbers"),
    (SENSORS.format("7"), "scenario.sensors.2", "needs 3 finite numbers, got 7"),
    (SENSORS.format("[a,b,c]"), "scenario.sensors.2", "needs 3 finite numbers"),
    (SENSORS.format("[29.5,29.5,0]"), "scenario.sensors.2", "lies on vehicle 0"),
    (SENSORS.format("[-30,-30,-8]"), "scenario.sensors.2", "lies on the source"),
    (SENSORS.format("[30,30,-8]"), "scenario.sensors.2", "lies on the destination"),
    (
        "scenario.start=[[0,0,-5,0]] scenario.sensors=[[2,0,-5],[0,2,-5],[0,0,-7]]",
        "scenario.sensors",
        "all 3 sensors are 2 m from vehicle 0",
    ),
    # channel
    ("channel.K_dB=nan", "channel.K_dB", "must be finite"),
    ("channel.N0_dB=-inf", "channel.N0_dB", "must be finite"),
    ("channel.n=0", "channel.n", "must be greater than 0"),
    ("channel.bandwidth_khz=-1", "channel.bandwidth_khz", "must be greater than 0, got -1"),
    ("channel.rho_dB=-0.1", "channel.rho_dB", "must be at least 0, got -0.1"),
    ("channel.zeta_dB=-0.1", "channel.zeta_dB", "must be at least 0, got -0.1"),
    ("channel.varphi_m=0", "channel.varphi_m", "must be greater than 0, got 0"),
    ("channel.water.temperature_C=36", "channel.water.temperature_C", "must lie in [-2, 35], got 36"),
    ("channel.water.temperature_C=-2.1", "channel.water.temperature_C", "must lie in [-2, 35], got -2.1"),
    ("channel.water.salinity_ppt=-1", "channel.water.salinity_ppt", "must lie in [0, 45], got -1"),
    ("channel.water.salinity_ppt=nan", "channel.water.salinity_ppt", "must lie in [0, 45]"),
    ("channel.water.depth_m=12000", "channel.water.depth_m", "must lie in [0, 11000], got 12000"),
    ("channel.water.pH=9.1", "channel.water.pH", "must lie in [7, 9], got 9.1"),
    ("channel.absorption=francois_garrison", "channel.frequency_khz", "francois_garrison needs a frequency in kHz"),
    ("channel.absorption=fisher_simons", "channel.absorption", "did you mean 'fisher_simmons'?"),
    ("channel.absorption=thorpe", "channel.absorption", "did you mean 'thorp'?"),
    ("channel.frequency_khz=24", "channel.frequency_khz", "has no effect without absorption"),
    ("channel.absorption=thorp", "channel.frequency_khz", "absorption thorp needs a frequency in kHz"),
    ("channel=acoustic_24khz channel.frequency_khz=0", "channel.frequency_khz", "must be greater than 0"),
    # vehicle
    ("vehicle.mass_kg=0", "vehicle.mass_kg", "must be greater than 0"),
    ("vehicle.yaw_inertia=nan", "vehicle.yaw_inertia", "must be greater than 0"),
    ("vehicle.added_mass=[1,1,1]", "vehicle.added_mass", "needs 4 finite numbers"),
    ("vehicle.added_mass=[1,1,-1,1]", "vehicle.added_mass", "heave must be at least 0, got -1"),
    ("vehicle.linear_damping=[1,-1,1,1]", "vehicle.linear_damping", "sway must be at least 0, got -1"),
    ("vehicle.quadratic_damping=[0,1,1,1]", "vehicle.quadratic_damping", "surge must be greater than 0, got 0"),
    ("vehicle.tau_max=[85,85,120,0]", "vehicle.tau_max", "yaw must be greater than 0, got 0"),
    ("vehicle.weight_N=nan", "vehicle.weight_N", "must be at least 0"),
    ("vehicle.weight_N=300", "vehicle.tau_max", "heave 120 N cannot hold the net weight of 185.2 N"),
    ("scenario.dt_s=0.08 scenario.message_period_s=0.4", "scenario.dt_s", "cannot be integrated stably: yaw"),
    # estimator and basis
    ("estimator.name=orakle", "estimator.name", "did you mean 'oracle'?"),
    ("estimator.name=maximum_likelyhood", "estimator.name", "did you mean 'maximum_likelihood'?"),
    ("estimator.name=kalman", "estimator.name", "'kalman' is none of least_squares, generalized_least_squares"),
    ("basis.name=link", "basis.name", "'link' is none of link_frame, geodesic, error_quadratic, error_velocity"),
    ("basis.length_scales_m=[]", "basis.length_scales_m", "needs one or more different positive lengths"),
    ("basis.length_scales_m=[2,0]", "basis.length_scales_m", "needs one or more different positive lengths"),
    ("basis.length_scales_m=[2,nan]", "basis.length_scales_m", "needs one or more different positive lengths"),
    ("basis.length_scales_m=[2,inf,2]", "basis.length_scales_m", "needs one or more different positive lengths"),
    # cost
    ("cost.beta_1=0", "cost.beta_1", "must be greater than 0"),
    ("cost.yaw_weight=-0.01", "cost.yaw_weight", "must be at least 0"),
    ("cost.R=[1,1,1]", "cost.R", "needs 4 finite numbers"),
    ("cost.R=[1,1,0,1]", "cost.R", "must be positive definite"),
    # solver
    ("solver.name=z_rsl", "solver.name", "did you mean 'z_rls'?"),
    ("solver.ridge=-1", "solver.ridge", "must be at least 0"),
    ("solver.prior=inf", "solver.prior", "must be at least 0, got inf"),
    ("solver=rls_paper solver.kappa=0", "solver.kappa", "must be greater than 0"),
    ("solver=rls_paper solver.p0=0", "solver.p0", "must be greater than 0"),
    ("solver=rls_forgetting solver.kappa=1.01", "solver.kappa", "a forgetting factor lies in (0, 1], got 1.01"),
    # experience
    ("experience.leg_s=0", "experience.leg_s", "must be greater than 0"),
    ("experience.leg_s=5.02", "experience.leg_s", "5.02 s is no whole number of steps"),
    ("experience.leg_s=0.4", "experience.leg_s", "0.4 s is shorter than planner.window_s"),
    ("experience.excitation_rms=[1,1,1]", "experience.excitation_rms", "needs 4 finite numbers"),
    ("experience.excitation_rms=[1,1,0,1]", "experience.excitation_rms", "heave must be greater than 0"),
    ("experience.excitation_strength=[0.5]", "experience.excitation_strength", "needs 2 finite numbers"),
    ("experience.excitation_strength=[1,0.2]", "experience.excitation_strength", "with 0 <= low <= high"),
    ("experience.excitation_band_rad_s=[-1,4]", "experience.excitation_band_rad_s", "with 0 <= low <= high"),
    ("experience.across_share=0", "experience.across_share", "must be greater than 0"),
    ("experience.up_m=0", "experience.up_m", "must be greater than 0"),
    ("experience.yaw_rad=0", "experience.yaw_rad", "must be greater than 0"),
    ("experience.near_scale=0", "experience.near_scale", "must be greater than 0"),
    ("experience.near_share=1.1", "experience.near_share", "is a share between 0 and 1, got 1.1"),
    ("experience.near_share=nan", "experience.near_share", "is a share between 0 and 1"),
    ("experience.relabel=-1", "experience.relabel", "must be at least 0, got -1"),
    ("experience.relabel_time_s=0", "experience.relabel_time_s", "must be greater than 0"),
    (f"{PARALLEL} experience.worlds=0", "experience.worlds", "must be at least 1, got 0"),
    # planners
    ("planner.name=ilr", "planner.name", "did you mean 'irl'?"),
    ("planner.calibration_s=0.15", "planner.calibration_s", "0.15 s is shorter than 4 steps"),
    ("planner=pd planner.position_gain=[1,1,1]", "planner.position_gain", "needs 4 finite numbers"),
    ("planner=pd planner.velocity_gain=[1,1,1,0]", "planner.velocity_gain", "yaw must be greater than 0"),
    ("planner=pd planner.saturation_m=0", "planner.saturation_m", "must be greater than 0"),
    ("planner.window_s=0.05", "planner.window_s", "0.05 s is shorter than 2 steps"),
    ("planner.window_s=0.45", "planner.window_s", "must be an even number of steps for Simpson's rule, got 9 x 0.05 s"),
    ("planner.stride_s=0.07", "planner.stride_s", "0.07 s is no whole number of steps"),
    ("planner.residual_floor=0", "planner.residual_floor", "must be greater than 0"),
    ("planner.updates=0", "planner.updates", "must be at least 1, got 0"),
    ("planner.actor_sign=print", "planner.actor_sign", "did you mean 'printed'?"),
    ("planner.inertia_lower=[12,12,12]", "planner.inertia_lower", "needs 4 finite numbers"),
    ("planner.inertia_lower=[12,0,12,0.2]", "planner.inertia_lower", "sway must be greater than 0"),
    ("planner.inertia_lower=[12,0.1,12,0.2]", "planner.inertia_lower", "sway must be at least 0.2"),
    ("planner.inertia_lower=[12,12,12,0.1]", "planner.inertia_lower", "yaw must be at least 0.15"),
    ("planner.name=pd", "planner.name", "choose it with planner=pd"),
    ("planner.max_time_s=nan", "planner.max_time_s", "must be greater than 0"),
    ("planner.start_gain=nan", "planner.start_gain", "must be finite"),
    ("experience.name=parallel", "experience.name", "choose it with experience=parallel"),
    ("solver.name=rls_paper", "solver.name", "choose it with solver=rls_paper"),
    ("solver=batch solver.bounded=true", "solver.bounded", "says otherwise than the solver's name"),
    ("planner.tolerance_weights=-1", "planner.tolerance_weights", "must be at least 0"),
    ("planner.tolerance_inverse_capacity=-1", "planner.tolerance_inverse_capacity", "must be at least 0"),
    (f"{HOVER_AND_LEG}=19.9", "planner.max_time_s", "19.9 s is shorter than the calibration hover and one leg"),
    ("baseline.name=dp", "baseline.name", "'dp' is none of irl, identified, pd"),
    ("baseline.saturation_m=-4", "baseline.saturation_m", "must be greater than 0"),
    ("planner@baseline=irl baseline.updates=0", "baseline.updates", "must be at least 1"),
    # the rest
    ("scenario.dt_s=1e-310", "scenario.duration_s", "more than 1,000,000 steps"),
    ("seed=-1", "seed", "must lie in [0, 2^63)"),
    ("device=gpu", "device", "'gpu' is none of cpu, cuda, cuda:N, mps"),
    (f"{CYLINDER.format('[29.5,28.5]', 1)}", "scenario.obstacles.0", "to the start of vehicle 1"),
    (f"{CYLINDER.format('[1,0]', 1)}", "scenario.obstacles.0", "to the target"),
    (f"{CYLINDER.format('[9,9]', 0)}", "scenario.obstacles.0.radius_m", "must be greater than 0"),
    (f"{CYLINDER.format('[9,9]', 7)}", "scenario.obstacles.0.influence_m", "must exceed radius_m = 7"),
    (f"{CYLINDER.format('[9]', 1)}", "scenario.obstacles.0.center_m", "needs 2 finite numbers"),
    ("scenario.vehicle_radius_m=0", "scenario.vehicle_radius_m", "must be greater than 0"),
    ("cost.beta_2=-1", "cost.beta_2", "must be at least 0"),
    ("guidance.gain=0", "guidance.gain", "must be greater than 0"),
    ("guidance.spacing_m=0.01", "guidance.spacing_m", "makes maps of 36,000,000 nodes"),
    ("guidance.name=straight", "guidance.name", "choose it with guidance=straight"),
    ("safety.margin_m=-0.1", "safety.margin_m", "must be at least 0"),
    ("safety.alpha=0", "safety.alpha", "must be greater than 0"),
    # bounds that do not cover the vehicle, and the advice that is printed
    (
        "vehicle.mass_kg=120 safety.mass_upper_kg=30",
        "safety.mass_upper_kg",
        "less than the vehicle's 132.7 kg in sway, added mass included, so",
    ),
    ("vehicle.mass_kg=20 safety.mass_upper_kg=32", "safety.mass_upper_kg", "set safety.mass_upper_kg=36"),
    (
        "vehicle.mass_kg=1 safety.mass_lower_kg=12",
        "safety.mass_lower_kg",
        "more than the vehicle's 6.5 kg in surge, added mass included, so",
    ),
    (
        "vehicle=bluerov2_heavy experiment=fig6_pair safety.mass_upper_kg=30",
        "safety.mass_upper_kg",
        "32.18 kg in heave",
    ),
    ("experiment=fig6_pair safety.separation_m=0.5", "safety.separation_m", "less than two scenario.vehicle_radius_m"),
    ("safety.alpha=21", "safety.alpha", "must be at most 1 / scenario.dt_s = 20"),
    ("safety=barrier safety.k_0=1.1", "safety.k_0", "must be at most safety.k_1^2 / 4 = 1"),
    ("safety.mass_upper_kg=5", "safety.mass_upper_kg", "lies below safety.mass_lower_kg = 12"),
    (
        "safety.brake_force_N=90",
        "safety.brake_force_N",
        "exceeds the 85 N of vehicle.tau_max that weight and current leave",
    ),
    ("safety.name=none", "safety.name", "choose it with safety=none"),
    ("threads=0", "threads", "must be at least 1, got 0"),
    ("dtype=float46", "dtype", "did you mean 'float64'?"),
]

ALLOWED = [
    "",
    "scenario.start=[[0,0,-5,0]]",
    "scenario.sensors=3",
    "scenario.sensors=[[0,0,-8],[5,0,-8],[5,0,-8]]",
    "channel.rho_dB=0",
    "channel.absorption=thorp channel.frequency_khz=1",
    "channel.absorption=fisher_simmons channel.frequency_khz=24",
    "channel.zeta_dB=0",
    "channel.water.temperature_C=-2 channel.water.salinity_ppt=0 channel.water.depth_m=11000 channel.water.pH=9",
    "scenario.hearing_range_m=inf",
    "scenario.hearing_range_m=1",
    "scenario.message_period_s=0.05",
    "estimator.robust=true",
    "vehicle.linear_damping=[0,0,0,0]",
    "vehicle.added_mass=[0,0,0,0] scenario.dt_s=0.025 safety.mass_lower_kg=11.5",
    "vehicle.weight_N=114.8",
    "scenario.dt_s=0.0625 planner.window_s=0.5 planner.stride_s=0.25 vehicle.tau_max=[85,85,120,20]",
    "basis.length_scales_m=[inf]",
    "cost.yaw_weight=0",
    "solver.ridge=0 solver.prior=0",
    "solver=rls_forgetting solver.kappa=1",
    "solver=rls_paper solver.kappa=1.01",
    "experience.leg_s=1",
    "experience.excitation_strength=[0.5,0.5]",
    "experience.near_share=0",
    "experience.near_share=1",
    "experience.relabel=0",
    f"{PARALLEL} experience.worlds=1",
    "planner.calibration_s=0.2",
    "planner.window_s=0.1",
    "planner.tolerance_weights=0 planner.tolerance_inverse_capacity=0",
    f"{HOVER_AND_LEG}=20",
    "planner.actor_sign=printed",
    "dtype=float32",
    "vehicle.mass_kg=120 safety.mass_upper_kg=146",
    "vehicle.mass_kg=1 safety.mass_lower_kg=5.9",
    "vehicle=bluerov2_heavy experiment=fig6_pair safety.mass_upper_kg=36",
    # The guard's bounds follow the vehicle.
    "vehicle.mass_kg=120 vehicle.weight_N=1177 vehicle.buoyancy_N=1179",
    "vehicle.mass_kg=1",
    "vehicle=bluerov2_heavy experiment=fig6_pair",
    "vehicle.tau_max=[85,40,120,26]",
    # Nothing to guard against.
    "experiment=fig5_free vehicle.mass_kg=120",
    # Only a learner needs experience.
    "planner=pd experience.leg_s=0",
]


@pytest.mark.parametrize(("overrides", "key", "fragment"), RULES, ids=[row[0] for row in RULES])
def test_rule(overrides: str, key: str, fragment: str):
    with pytest.raises(ConfigError) as caught:
        validate(compose(overrides.split()))
    assert caught.value.key == key
    assert str(caught.value).startswith(f"{key}: ")
    assert fragment in str(caught.value)
    assert "\n" not in str(caught.value)
    # Keys and advice can be typed as they are printed.
    assert parsed(f"{key}=1").key_or_group == key
    for advice in re.findall(r"(?:set|add|choose|with) ([\w./@]+=[\w.-]+)", str(caught.value)):
        compose([*overrides.split(), advice])


@pytest.mark.parametrize("overrides", ALLOWED)
def test_just_within_the_rules(overrides: str):
    validate(compose(overrides.split()))


@pytest.mark.parametrize(
    ("overrides", "sentence"),
    [
        ("safety=barrier", ""),
        (
            "safety=barrier vehicle.mass_kg=20",
            "safety.inertia_kg assumes 17 kg in surge, where the vehicle has 25.5 kg",
        ),
        ("experiment=fig6_pair", ""),
        ("experiment=fig6_pair scenario.start=[[9,9,-8,0],[-9,-9,-8,0]]", "vehicle 1 starts nearer to the source than"),
    ],
)
def test_cautions(overrides: str, sentence: str):
    config = compose(overrides.split())
    validate(config)
    found = " ".join(cautions(config))
    assert sentence in found
    assert bool(sentence) == bool(found)


def test_step_limit_is_rk4s():
    def growth(z: float) -> float:
        return abs(1.0 + z + z**2 / 2.0 + z**3 / 6.0 + z**4 / 24.0)

    assert growth(-RK4_STABILITY) <= 1.0
    assert growth(-RK4_STABILITY - 0.001) > 1.0


def test_a_compiler_that_is_not_there(make_config, monkeypatch):
    monkeypatch.setenv("CXX", "no-such-compiler")
    with pytest.raises(ConfigError, match=r"^compile: needs a C\+\+ compiler"):
        validate(make_config("compile=true"))
