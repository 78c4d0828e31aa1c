"""extra/org.phfmu.ports/fmi-ls-manifest.xml: what the standard cannot say about power ports.

It names the conjugate pairs, the energies, and what the directional derivative of a step output is.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from phfmu.declare.port import Domain, Given, Port
from phfmu.fmu import limits
from phfmu.fmu.export.description import ExportedUnit
from phfmu.fmu.export.value_groups import JUMP
from phfmu.fmu.words import plain
from phfmu.fmu.xml import Element, etree, number, text_of
from phfmu.signals import CONSTANT, JUMPED, LEDGER, MEAN, STEP_LEDGER, pair_energies, port_energy, total
from phfmu.terms.port_impulses import Impulse, PortImpulse

LAYER = "org.phfmu.ports"
PATH = f"extra/{LAYER}/fmi-ls-manifest.xml"
VERSION = "1.0.0"
_LS = "http://fmi-standard.org/fmi-ls-manifest"

#: attributes of a port that describe its domain
DOMAIN = {
    "domain": "name",
    "effort": "effort",
    "effortUnit": "effort_unit",
    "flow": "flow",
    "flowUnit": "flow_unit",
    "common": "common",
}
#: attributes of what has derivatives by states and parameters -> places in the unit
DERIVED = {
    "states": ("PH_X",),
    "ofStep": ("PH_A", "PH_Y_STEP"),
    "now": ("PH_A_END", "PH_Y_END", "PH_OBSERVABLES", "FMU_JUMP"),
}
#: attributes of the energies of one step
ENERGY = {
    "stored_step": "storedStep",
    "supplied_step": "suppliedStep",
    "dissipated_step": "dissipatedStep",
    "moved_step": "movedStep",
}

TEXT = (
    "power ports with conjugate pairs: (length of the step) * input * step output is the energy supplied "
    "to the component in a step, exactly"
)
OUTWARD = '; of a port with sign="-1.0" the one of a pair that sums to zero at a connection counts out of it: take the negative'
DERIVATIVE = (
    "the directional derivative of a step output with respect to a port input is the sensitivity of the "
    "step map of the last communication step, of which at most 16 internal steps may have been halved"
)
BY_STATES = (
    "beyond outputs of the description, directional (and adjoint) derivatives are told of the states listed, at the end of the "
    "last communication step, and of what is listed of the step, with respect to the states at its start, parameters and inputs "
    "held in it or at its nodes; of what is listed now with respect to the states now, parameters and inputs now"
)
NODES = (
    "inputs at the nodes of the next communication step (places and weights on [0, 1]); setting the input itself "
    "sets all of them, what is set last counts; (length of the step) * sum of weight * node input * node output is "
    "the energy supplied to the component in a step, exactly"
)
NODE_DERIVATIVE = (
    "the directional derivative of an output at a node with respect to inputs at nodes and impulses is the sensitivity of the "
    "step map of the last communication step; where there are impulses, that of an output at the present time is too"
)
IMPULSES = (
    "impulses at the start and at the end of the coming communication steps, which stay until they are set; the outputs "
    "conjugate to the inputs listed change by jump times impulse (lower triangle of a symmetric matrix, at the present time)"
)
FAILURE = (
    "a step that cannot be solved is discarded and leaves the unit at the last communication point; a smaller step may follow. "
    "Of several internal steps the solved ones are told (fmi2LastSuccessfulTime), or kept if early return is allowed (FMI 3.0)"
)


@dataclass(frozen=True)
class PortMap:
    """Names of one port's scalars: inputs, outputs at the present time, step means.

    power = sign * input * output is positive into the component: with sign -1 the one of the pair that sums to zero where
    ports of the domain meet counts out of it.  `step_outputs`: empty where there are none;
    `vector`: the scalars are entries of a vector, also if there is only one.  `node_inputs`, `node_outputs`: per pair
    the names at the nodes of a step; empty where there are none.  `impulses`: per pair the names of its impulses, `impulse`: what
    they leave of the balance; empty without; `linear`: outputs are linear in the states, `why`: not more.  `pair_energies`:
    energies of the last step.  `displacements`: of units of other tools, what the outputs
    are the rates of; empty where that is not told.  `input_factor` and the others: units of the domain in a unit of the variable.
    """

    name: str
    domain: Domain
    given: Given
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    step_outputs: tuple[str, ...] = ()
    sign: float = 1.0
    vector: bool = False
    node_inputs: tuple[tuple[str, ...], ...] = ()
    node_outputs: tuple[tuple[str, ...], ...] = ()
    displacements: tuple[str, ...] = ()
    input_factor: float = 1.0
    output_factor: float = 1.0
    displacement_factor: float = 1.0
    impulses: tuple[tuple[str, ...], ...] = ()
    impulse: str = ""
    linear: bool = False
    why: str = ""
    pair_energies: tuple[str, ...] = ()

    @property
    def input_sign(self) -> float:
        """Sign of the inputs into the component, in units of the domain."""
        return self.input_factor * (self.sign if self.given == self.domain.summed else 1.0)

    @property
    def output_sign(self) -> float:
        """Sign of the outputs into the component, in units of the domain."""
        return self.output_factor * (self.sign if self.given != self.domain.summed else 1.0)

    @property
    def displacement_sign(self) -> float:
        """Sign of the displacements, which is that of the outputs."""
        return self.displacement_factor * (self.sign if self.given != self.domain.summed else 1.0)


def manifest(unit: ExportedUnit) -> bytes:
    """The document."""
    root = etree.Element("PowerPorts", nsmap={"fmi-ls": _LS})
    for name, value in (("name", LAYER), ("version", VERSION), ("description", TEXT + OUTWARD * bool(unit.outward))):
        root.set(f"{{{_LS}}}fmi-ls-{name}", value)
    offers = _add_step(root, unit)
    if unit.derives_by_states:
        derivatives = etree.SubElement(root, "Derivatives", description=BY_STATES)
        for word, blocks in DERIVED.items():
            own = (v for v in unit.variables if v.causality != "independent" and unit.has_derivatives(v))
            names = [v.name for v in own if v.block in blocks]
            derivatives.set(word, " ".join(names))
    for text in unit.left_out:
        etree.SubElement(root, "LeftOut", what=plain(text))
    for e in unit.events:
        etree.SubElement(root, "Event", time=number(e.t), name=e.name, value=number(e.value))
    _add_energy(root, unit)
    for v in unit.variables:
        if v.block == "FMU_TUNABLE" and v.causality == "parameter":
            etree.SubElement(root, "Tunable", name=v.name)
    k = unit.model.step.k if unit.at_nodes else 0
    for port in unit.declaration.ports:
        if port.external and port.signal:
            _add_signals(root, port, k)
        elif port.external:
            _add_port(root, port, k, offers.get(port.name), port.name in unit.outward)
    return text_of(root)


def _add_step(root: Element, unit: ExportedUnit) -> dict[str, PortImpulse]:
    """The scheme, what derivatives and failures of a step mean, and its nodes; returns the impulses of the ports."""
    step = etree.SubElement(root, "Step", internalStepSize=number(unit.step))
    step.set("scheme", unit.model.scheme.name)
    step.set("order", str(unit.model.scheme.order))
    step.set("directionalDerivative", DERIVATIVE)
    step.set("failure", FAILURE)
    if unit.at_nodes:
        step.set("nodes", " ".join(number(c) for c in unit.model.nodes))
        step.set("weights", " ".join(number(b) for b in unit.model.step.weights))
        step.set("nodeInputs", NODES)
        step.set("nodeDerivative", NODE_DERIVATIVE)
    return _add_impulses(step, unit)


def _add_energy(root: Element, unit: ExportedUnit) -> None:
    """Names of the energies, those of jumps where there are some, and of what is constant in H."""
    energy = etree.SubElement(root, "Energy")
    for what, _, _ in (*LEDGER, *STEP_LEDGER):
        energy.set(ENERGY.get(what, what), total(what))
    if unit.jumps or unit.lands:
        energy.set(JUMPED[0], total(JUMPED[0]))
    constant = [v.name for v in unit.variables if v.name == total(CONSTANT) or v.name.endswith("." + total(CONSTANT))]
    if constant:
        energy.set(CONSTANT, " ".join(constant))


def _add_port(root: Element, port: Port, k: int, offer: PortImpulse | None, outward: bool) -> None:
    """A power port with its domain and pairs, their names at the k nodes of a step (0: none), and its impulses."""
    element = etree.SubElement(root, "Port", name=port.name, given=port.given)
    for name, attribute in DOMAIN.items():
        element.set(name, getattr(port.domain, attribute))
    element.set("energy", port_energy(port.name))
    element.set("vector", "false" if port.size is None else "true")
    if outward:
        element.set("sign", number(-1.0))
    if offer:
        element.set("impulse", offer.kind)
        element.set("linear", "true" if offer.linear else "false")
        if offer.reason:
            element.set("why", plain(offer.reason))
    names = zip(port.input_names(), port.output_names(), port.output_names(MEAN), strict=True)
    for j, pair in enumerate(names):
        about: dict[str, str] = dict(zip(("input", "output", "stepOutput"), pair, strict=True))
        if k:
            about["nodeInputs"] = " ".join(port.node_input_names(k)[j])
            about["nodeOutputs"] = " ".join(port.node_output_names(k)[j])
        if offer:
            about["energyStep"] = pair_energies(port)[j]
            if offer.kind is not Impulse.NONE:
                about["impulses"] = " ".join(port.impulse_names()[j])
        etree.SubElement(element, "Pair", about)


def _add_signals(root: Element, port: Port, k: int) -> None:
    """Values without power at the k nodes of a step, none without inputs there."""
    if not k:
        return
    at_nodes = port.node_output_names(k) if port.sends else port.node_input_names(k)
    for name, nodes in zip(port.input_names(), at_nodes, strict=True):
        etree.SubElement(
            root, "Signal", name=name, causality="output" if port.sends else "input", nodes=" ".join(nodes)
        )


def _add_impulses(step: Element, unit: ExportedUnit) -> dict[str, PortImpulse]:
    """The use of impulses by the ports of a unit; empty without."""
    if unit.kernels is None:
        return {}
    names = [n for p in unit.declaration.ports if p.external for n in p.input_names()]
    step.set("impulses", " ".join(names[j] for j in unit.kernels.forms.pairs))
    step.set("jump", JUMP)
    step.set("impulseInputs", IMPULSES)
    return {p.port: p for p in unit.kernels.forms.ports}


def read_ports(root: Element) -> list[PortMap]:
    """The ports of a manifest."""
    ports = []
    for port in root.findall("Port"):
        pairs = port.findall("Pair")
        inputs, outputs, means = (tuple(p.get(k, "") for p in pairs) for k in ("input", "output", "stepOutput"))
        lists = [
            tuple(tuple(p.get(k, "").split()) for p in pairs if p.get(k))
            for k in ("nodeInputs", "nodeOutputs", "impulses")
        ]
        about: dict[str, Any] = {attribute: plain(port.get(name, ""), 100) for name, attribute in DOMAIN.items()}
        given: Given = "flow" if port.get("given") == "flow" else "effort"
        vector = port.get("vector") == "true"
        ports.append(
            PortMap(
                plain(port.get("name", ""), limits.NAME),
                Domain(**about),
                given,
                inputs,
                outputs,
                means,
                -1.0 if port.get("sign", "").startswith("-") else 1.0,
                vector,
                node_inputs=lists[0],
                node_outputs=lists[1],
                impulses=lists[2],
                impulse=port.get("impulse", ""),
                linear=port.get("linear") == "true",
                why=plain(port.get("why", "")),
                pair_energies=tuple(p.get("energyStep", "") for p in pairs if p.get("energyStep")),
            )
        )
    return ports


def _read_signals(root: Element, causality: str) -> dict[str, tuple[str, ...]]:
    found = [s for s in root.findall("Signal") if s.get("causality") == causality]
    return {plain(s.get("name", ""), limits.NAME): tuple(s.get("nodes", "").split()) for s in found}


def _scheme(step: Element) -> str:
    words = [plain(step.get("scheme", ""), limits.NAME), plain(step.get("order", ""), limits.NAME)]
    return f"{words[0]}, order {words[1]}" if all(words) else ""


def read_manifest(root: Element) -> dict[str, Any]:
    """Ports, names of the energies, the scheme with its order, places and weights of the nodes, as `UnitInterface` has them."""
    energy, step, derived = root.find("Energy"), root.find("Step"), root.find("Derivatives")
    places = [() if step is None else tuple(float(v) for v in step.get(k, "").split()) for k in ("nodes", "weights")]
    return {
        "ports": tuple(read_ports(root)),
        "energy": {} if energy is None else {str(k): str(v) for k, v in energy.attrib.items()},
        "scheme": "" if step is None else _scheme(step),
        "nodes": places[0],
        "weights": places[1],
        "impulses": () if step is None else tuple(step.get("impulses", "").split()),
        "derived": {} if derived is None else {word: tuple(derived.get(word, "").split()) for word in DERIVED},
        "jump": "" if step is None else plain(step.get("jump", ""), limits.NAME),
        **{word: _read_signals(root, causality) for word, causality in (("taken", "input"), ("sent", "output"))},
    }
