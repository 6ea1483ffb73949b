"""The parameters that a node has declared, and their values."""

from collections.abc import Callable, Mapping
import difflib
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter

from .mission_parameters import of_mission
from .spec import Spec
from ..errors import brief, PlanningError

# What the parameters that every node of ROS has begin with.
_OF_ROS = ('qos_overrides.', 'use_sim_time', 'start_type_description_service')


class Parameters:
    """
    The declared parameters of a node; a change is validated as a whole, then applied as a whole.

    What is not set is as in the mission of the parameter `mission_file`, or else by default.

    :param specs: a Spec for each parameter name.
    :param check: called with all values by name; it raises a PlanningError for a wrong
        combination.
    :param of_members: returns further specs, of the members that the values of the first ones
        name.
    :raises ParameterError: for a wrong value at the start; the text names the parameter.
    """

    def __init__(self, node: Node, specs: Mapping[str, Spec],
                 check: Callable[[dict[str, Any]], None],
                 of_members: Callable[[dict[str, Any]], dict[str, Spec]] = lambda values: {}
                 ) -> None:
        self._specs: dict[str, Spec] = {}
        self._check = check
        self._values: dict[str, Any] = {}
        self._node = node
        self._of_mission: dict[str, Any] = {}
        self._declare(specs)
        self._declare(of_members(self._values))
        check(self._values)
        node.add_on_set_parameters_callback(self._on_set)

    def _declare(self, specs: Mapping[str, Spec]) -> None:
        given = _given(self._node)
        for name, spec in specs.items():
            value = self._of_mission.get(name, spec.default)
            if name in given:
                value = given[name].value
                if value is None and isinstance(spec.default, list):
                    value = []  # Which rcl does not tell from no value.
            self._specs[name] = spec
            self._values[name] = spec.checked(name, value, 'parameter ')
            self._node.declare_parameter(
                name, self._values[name], spec.descriptor(), ignore_override=True)
            if name == 'mission_file' and value:  # It is the first one.
                self._of_mission = of_mission(value)

    def __getitem__(self, name: str) -> Any:
        return self._values[name]

    def snapshot(self) -> dict[str, Any]:
        """Return all present values by name; later changes do not affect them."""
        return self._values

    def warn_of_unknown(self) -> None:
        """Log every given parameter that does not exist, with the nearest name that does."""
        for name in sorted(_given(self._node)):
            if self._node.has_parameter(name) or name.startswith(_OF_ROS):
                continue
            near = difflib.get_close_matches(name[:200], self._specs, 1)
            hint = f'; did you mean {near[0]}?' if near else ''
            self._node.get_logger().warning(
                f'there is no parameter {brief(name, 100)}, it is ignored{hint}')

    def _on_set(self, parameters: list[Parameter]) -> SetParametersResult:
        ours = [parameter for parameter in parameters if parameter.name in self._specs]
        if not ours:  # rclpy declares many for each topic and calls this for every one.
            return SetParametersResult(successful=True)
        try:
            values = self._values | {
                parameter.name: self._specs[parameter.name].checked(
                    parameter.name, parameter.value) for parameter in ours}
            self._check(values)
        except PlanningError as error:
            return SetParametersResult(successful=False, reason=brief(error))
        self._values = values
        return SetParametersResult(successful=True)


def _given(node: Node) -> dict[str, Parameter]:
    """Return all parameters from the command line and parameter files of a node by name."""
    return node._parameter_overrides  # rclpy has no public access to them.
