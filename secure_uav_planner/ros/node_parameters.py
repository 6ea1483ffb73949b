"""The parameters that a node has declared, and their values."""

from collections.abc import Callable, Mapping
import difflib
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rclpy.exceptions import ParameterException
from rclpy.node import Node
from rclpy.parameter import Parameter

from .spec import Spec
from .text import brief
from ..errors import ParameterError, PlanningError
from ..mission.parameters import OF_ROS


class Parameters:
    """
    The declared parameters of a node; a change is validated as a whole, then applied as a whole.

    :param node: a Node.
    :param specs: a Spec for each parameter name.
    :param check: called with all values by name; it raises a PlanningError for a wrong
        combination.
    :raises ParameterError: for a wrong value at the start; the text names the parameter.
    """

    def __init__(self, node: Node, specs: Mapping[str, Spec],
                 check: Callable[[dict[str, Any]], None] = lambda values: None) -> None:
        self._specs: dict[str, Spec] = {}
        self._check = check
        self._values: dict[str, Any] = {}
        self._node = node
        self.declare(specs)
        check(self._values)
        node.add_on_set_parameters_callback(self._on_set)

    def declare(self, specs: Mapping[str, Spec]) -> None:
        """Declare further parameters."""
        values = {}
        for name, spec in specs.items():
            try:
                self._node.declare_parameter(name, spec.default, spec.descriptor())
            except ParameterException as error:
                raise ParameterError(f'parameter {brief(name, 100)}: {brief(error.args[0])}; it '
                                     f'must be {spec.allowed}') from None
            values[name] = spec.checked(f'parameter {name}', self._node.get_parameter(name).value)
        self._specs.update(specs)
        self._values = {**self._values, **values}

    def __getitem__(self, name: str) -> Any:
        return self._values[name]

    def snapshot(self) -> dict[str, Any]:
        """Return all present values by name; later changes do not affect them."""
        return self._values

    def apply(self, check: Callable[[dict[str, Any]], None]) -> None:
        """Check all values with another function, now and at every change."""
        check(self._values)
        self._check = check

    def warn_of_unknown(self) -> None:
        """Log every given parameter that does not exist, with the nearest name that does."""
        for name in sorted(_given(self._node)):
            if self._node.has_parameter(name) or name.startswith(OF_ROS):
                continue
            near = difflib.get_close_matches(name[:200], self._specs, 1)
            hint = f'; did you mean {near[0]}?' if near else ''
            self._node.get_logger().warning(
                f'there is no parameter {brief(name, 100)}, it is ignored{hint}')

    def _on_set(self, parameters: list[Parameter]) -> SetParametersResult:
        values = dict(self._values)
        try:
            for parameter in parameters:
                if parameter.name in self._specs:
                    values[parameter.name] = self._specs[parameter.name].checked(
                        parameter.name, parameter.value)
            self._check(values)
        except PlanningError as error:
            return SetParametersResult(successful=False, reason=brief(error))
        self._values = values
        return SetParametersResult(successful=True)


def _given(node: Node) -> list[str]:
    """Return the names of all parameters from the command line and parameter files of a node."""
    # rclpy has no public access to them. Without it, misspelt names would go unnoticed.
    return list(getattr(node, '_parameter_overrides', {}))
