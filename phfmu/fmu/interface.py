"""What a unit says about itself: modelDescription.xml of both versions, and the ports of the manifest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from phfmu.declare.port import Port
from phfmu.fmu.manifest import PortMap, read_ports
from phfmu.fmu.variables import FMUError
from phfmu.fmu.xml import Element, parse

TRUE = ("true", "1")


@dataclass(frozen=True)
class Scalar:
    """A scalar variable of type Real or Float64."""

    name: str
    reference: int
    causality: str
    start: float | None = None
    unit: str = "1"
    nominal: float = 1.0
    description: str = ""


@dataclass(frozen=True)
class Interface:
    """A unit for Co-Simulation.  `ports` and `energy` are those of the manifest, empty in foreign units.

    `nodes`, `weights`: places on [0, 1] and weights of the nodes at which ports take inputs; empty without such inputs.
    """

    version: str
    name: str
    identifier: str
    token: str
    variables: dict[str, Scalar]
    saves: bool
    derivatives: bool
    start: float = 0.0
    stop: float | None = None
    step: float | None = None
    description: str = ""
    ports: tuple[PortMap, ...] = ()
    energy: dict[str, str] = field(default_factory=dict)
    nodes: tuple[float, ...] = ()
    weights: tuple[float, ...] = ()

    def references(self, names: list[str] | tuple[str, ...], what: str) -> list[int]:
        """Value references; FMUError names those there are not."""
        from difflib import get_close_matches

        missing = [n for n in names if n not in self.variables]
        if missing:
            close = get_close_matches(missing[0], self.variables, 5)
            hint = f"; did you mean {', '.join(close)}?" if close else ""
            raise FMUError(f"{self.name} has no {what} '{missing[0]}'{hint}")
        return [self.variables[n].reference for n in names]

    def declared_ports(self, ports: Sequence[PortMap] | None = None) -> tuple[Port, ...]:
        """The ports as a declaration has them, for a network to join; they act on no visible variables."""
        return tuple(
            Port(
                p.name, p.domain, p.given, {}, len(p.inputs) if p.vector or len(p.inputs) > 1 else None,
                start=[self.variables[n].start or 0.0 for n in p.inputs],
                nominal=[self.variables[n].nominal for n in p.inputs],
                description=self.variables[p.inputs[0]].description if p.inputs else "",
            )
            for p in (self.ports if ports is None else ports)
        )  # fmt: skip


def read_interface(model_description: bytes, manifest: bytes | None, name: str) -> Interface:
    """The interface of a unit; `name` is for messages."""
    root = parse(model_description, f"{name}/modelDescription.xml")
    version = root.get("fmiVersion", "")
    if version == "2.0":
        scalars, token, flags = (
            _variables2(root),
            "guid",
            ("canGetAndSetFMUstate", "providesDirectionalDerivative"),
        )
    elif version.startswith("3."):
        scalars, token = _variables3(root), "instantiationToken"
        flags = ("canGetAndSetFMUState", "providesDirectionalDerivatives")
    else:
        raise FMUError(f"{name}: FMI version '{version}'; this reads 2.0 and 3.0")
    cosimulation = root.find("CoSimulation")
    if cosimulation is None:
        raise FMUError(f"{name}: the unit has no Co-Simulation interface")
    experiment = root.find("DefaultExperiment")
    times = {} if experiment is None else {k: float(v) for k, v in experiment.attrib.items() if k in _TIMES}
    ports, energy, nodes, weights = (), {}, (), ()
    if manifest is not None:
        about = parse(manifest, f"{name}/manifest")
        ports = tuple(read_ports(about))
        found = about.find("Energy")
        energy = {} if found is None else {str(k): str(v) for k, v in found.attrib.items()}
        step = about.find("Step")
        if step is not None:
            nodes, weights = (tuple(float(v) for v in step.get(k, "").split()) for k in ("nodes", "weights"))
    return Interface(
        version="2.0" if version == "2.0" else "3.0",
        name=root.get("modelName", name),
        identifier=cosimulation.get("modelIdentifier", ""),
        token=root.get(token, ""),
        variables=scalars,
        saves=cosimulation.get(flags[0]) in TRUE,
        derivatives=cosimulation.get(flags[1]) in TRUE,
        start=times.get("startTime", 0.0),
        stop=times.get("stopTime"),
        step=times.get("stepSize"),
        description=root.get("description", ""),
        ports=ports,
        energy=energy,
        nodes=nodes,
        weights=weights,
    )


_TIMES = ("startTime", "stopTime", "stepSize")


def _variables2(root: Element) -> dict[str, Scalar]:
    found = {}
    for v in root.iterfind("ModelVariables/ScalarVariable"):
        real = v.find("Real")
        if real is not None:
            scalar = _scalar(v, real)
            found[scalar.name] = scalar
    return found


def _variables3(root: Element) -> dict[str, Scalar]:
    """Arrays are left out: a port is made of scalars."""
    found = {}
    for v in root.iterfind("ModelVariables/Float64"):
        if v.find("Dimension") is None:
            scalar = _scalar(v, v)
            found[scalar.name] = scalar
    return found


def _scalar(v: Element, numbers: Element) -> Scalar:
    start, name = numbers.get("start"), v.get("name", "")
    try:
        return Scalar(
            name=name,
            reference=int(v.get("valueReference", "0")),
            causality=v.get("causality", "local"),
            start=None if start is None else float(start),
            unit=numbers.get("unit", "1"),
            nominal=float(numbers.get("nominal", "1")),
            description=v.get("description", ""),
        )
    except ValueError as error:
        raise FMUError(
            f"modelDescription.xml: variable '{name}': {error}; the unit is damaged, export it again"
        ) from None
