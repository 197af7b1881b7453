"""Vehicles of the fleet: bounds cover them, and those drawn by the seed can be flown."""

import pytest

from uwirl.config.compose import compose
from uwirl.config.validate import validate
from uwirl.config.vehicle_bounds import DRAG, MASS, drawn

FLEET = ("bluerov2", "bluerov2_heavy", "low_drag", "heavy_mass", "asymmetric", "weak", "random")
EXPERIMENTS = ("fig5_free", "fig5_single", "fig6_pair", "random_layouts")


@pytest.mark.parametrize("vehicle", FLEET)
@pytest.mark.parametrize("experiment", EXPERIMENTS)
def test_every_vehicle_flies_in_every_experiment(vehicle: str, experiment: str):
    # Both say how long a mission is.
    longer = ["scenario.duration_s=240"] if (vehicle, experiment) == ("bluerov2_heavy", "random_layouts") else []
    validate(compose([f"experiment={experiment}", f"vehicle={vehicle}", "planner=identified", *longer]))


@pytest.mark.parametrize("seed", range(30))
def test_drawn_vehicles_can_be_flown(seed: int):
    config = compose(["experiment=fig5_single", "vehicle=random", f"seed={seed}"])
    validate(config)
    vehicle, guard = config.vehicle, config.safety
    inertia = [vehicle.mass_kg + added for added in vehicle.added_mass[:3]]
    assert guard.mass_lower_kg <= min(inertia)
    assert max(inertia) <= guard.mass_upper_kg
    assert vehicle.buoyancy_N - vehicle.weight_N == pytest.approx(2.0)


def test_draws_cover_the_range_and_depend_on_the_seed_alone():
    mass = sorted(drawn(seed, "mass_kg") / 11.5 for seed in range(200))
    drag = sorted(drawn(seed, "quadratic_damping", 0) / 18.18 for seed in range(200))
    for factors, (low, high) in ((mass, MASS), (drag, DRAG)):
        assert low <= factors[0] < 1.1 * low
        assert high / 1.1 < factors[-1] <= high
    assert drawn(5, "mass_kg") == drawn(5, "mass_kg")


def test_bounds_that_cover_the_vehicle_stay_as_they_are():
    config = compose(["experiment=fig5_single"])
    assert (config.safety.mass_upper_kg, config.safety.mass_lower_kg, config.safety.brake_force_N) == (30.0, 12.0, 80.0)
    assert config.planner.inertia_lower == [12.0, 12.0, 12.0, 0.2]
