"""One strategy for each kind of plant, chosen from its nominal model, not from how many joints it
has."""

import numpy as np
import pytest

from tests.support.robots import arm_plant
from tests.support.simulated import recorded_twice as recorded
from trueup.diagnose.model_selection import PHYSICAL, ROBOT, SIMULATED, selection_criteria
from trueup.diagnose.strategy import LARGE_ROBOT, ONE_JOINT, strategy_for
from trueup.diagnose.strategy import ROBOT as ROBOT_EFFORT
from trueup.model.corrected import Corrected
from trueup.model.nominal_form import resolved
from trueup.model.plant import Plant
from trueup.model.predictor import Identified, Nominal

LEVER = """<mujoco><option timestep="0.004" integrator="implicitfast"/><worldbody><body>
<joint name="lever" axis="0 1 0" damping="0.1" armature="0.01"/>
<geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02" mass="0.5"/></body></worldbody>
<actuator><motor joint="lever"/></actuator></mujoco>"""


@pytest.fixture(scope="module")
def lever(tmp_path_factory):
    """A robot of one joint."""
    folder = tmp_path_factory.mktemp("lever")
    (folder / "lever.xml").write_text(LEVER)
    named = {"joint": "lever", "unit": "rad"}
    document = {
        "name": "lever",
        "nominal": {"mjcf": "lever.xml", "timestep_s": 0.01},
        "commands": [{"name": "tau", "joint": "lever", "unit": "N·m", "limits": [-2.0, 2.0]}],
        "observations": [
            {"name": "q", "field": "position", **named},
            {"name": "v", "field": "velocity", **named},
        ],
        "evaluation": {"horizon_s": 0.5},
    }
    return Plant.from_document(resolved(document, folder))


@pytest.fixture(scope="module")
def joint():
    return recorded("A1", [], 1)[0]


def test_a_joint_of_a_family_is_searched_as_one(joint):
    strategy = strategy_for(joint, SIMULATED)
    assert (strategy.robot, strategy.effort, strategy.in_pieces) == (False, ONE_JOINT, False)
    assert strategy.most_effects == 3


def test_a_robot_is_searched_as_one_however_many_joints_it_has(lever, tmp_path):
    for plant in (lever, arm_plant(tmp_path)):
        strategy = strategy_for(plant, ROBOT)
        assert (strategy.robot, strategy.effort, strategy.in_pieces) == (True, ROBOT_EFFORT, True)
        assert strategy.most_effects == 2
        assert selection_criteria(plant, []) is ROBOT


def test_a_robot_of_many_joints_is_searched_with_less_effort(lever):
    many = type("Many", (type(lever.dynamics),), {"joints": 6})(lever.dynamics.tree)
    plant = type("Robot", (), {"dynamics": many})()
    assert strategy_for(plant, ROBOT).effort is LARGE_ROBOT


def test_windows_of_a_machine_start_where_its_log_says_for_a_joint_alone(joint, lever):
    assert strategy_for(joint, PHYSICAL).held_starts
    assert not strategy_for(joint, SIMULATED).held_starts
    assert not strategy_for(lever, PHYSICAL).held_starts


def test_fits_of_a_robot_are_carried_to_the_end_where_laws_hold_exactly(joint, lever):
    assert strategy_for(joint, PHYSICAL).thorough
    assert strategy_for(lever, ROBOT).thorough
    assert not strategy_for(lever, PHYSICAL).thorough


def test_predictors_with_the_nominal_numbers_hold_a_command_alike_at_a_robot_of_one_joint(lever):
    states, commands = np.array([[0.2, 0.0], [-0.4, 1.0]]), np.array([[0.3], [-0.1]])
    nominal = Nominal(lever).hold(states, commands, 5)
    assert nominal.shape == (2, 5, 2)
    for model in (
        Identified(lever, lever.parameters),
        Corrected.of_numbers(lever, lever.parameters),
    ):
        held = model.hold(states, commands, 5)
        np.testing.assert_allclose(held, nominal, rtol=1e-12, atol=1e-15)
    assert not np.allclose(nominal[:, -1], states)
