"""Reading modelDescription.xml of all versions, tag by tag."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import product
from math import isfinite
from typing import IO, Any

from phfmu.declare.expressions.units import BASE, PhysicalUnit
from phfmu.fmu import limits
from phfmu.fmu.export.manifest import read_manifest
from phfmu.fmu.export.variables import FMUError
from phfmu.fmu.importer.unit_interface import Scalar, UnitInterface
from phfmu.fmu.version import FMI3, VERSIONS, Version, written_by
from phfmu.fmu.words import plain
from phfmu.fmu.xml import parse, read

TRUE, FALSE = ("true", "1"), ("false", "0")

_TIMES = ("startTime", "stopTime", "stepSize")
_KEPT = 3  # names of a kind of variables that are left out


@dataclass
class OmittedVariables:
    """Variables of one kind that cannot be read or set here: how many, and the first names."""

    count: int = 0
    names: list[str] = field(default_factory=list)

    def add(self, name: str) -> None:
        self.count += 1
        if len(self.names) < _KEPT:
            self.names.append(name)

    def __str__(self) -> str:
        return ", ".join(self.names) + (", ..." if self.count > len(self.names) else "")


class ModelDescription:
    """The contents of the document; the tags of `phfmu.fmu.xml.read`."""

    def __init__(self, name: str):
        self.file = name
        self.version: Version = FMI3
        self.root: dict[str, str] = {}
        self.cosimulation: dict[str, str] | None = None
        self.times: dict[str, float] = {}
        self.variables: dict[str, Scalar] = {}
        self.units: dict[str, PhysicalUnit] = {}
        self.left_out: dict[str, OmittedVariables] = {}
        self._counted = 0
        self._path: list[str] = []
        self._type = ""
        self._own: dict[str, str] = {}
        self._numbers: dict[str, str] = {}
        self._dimensions: list[dict[str, str]] = []
        self._sizes: dict[int, int] = {}  # value reference -> start of what may be the size of an array
        self._waiting: list[tuple[str, dict[str, str], list[dict[str, str]]]] = []
        self._shared: dict[str, str] = {}
        self._name = ""  # of the type or unit that is being read
        self._types: dict[str, dict[str, str]] = {}  # declared type -> what it says of its variables
        self._aliases: list[dict[str, str]] = []

    # -- tags -----------------------------------------------------------------------------------------------

    def start(self, tag: str, attributes: Mapping[str, str]) -> None:
        self._path.append(tag)
        depth = len(self._path)
        if depth == 1:
            self._take_root(tag, dict(attributes))
        elif depth == 2 and tag == "CoSimulation":
            self.cosimulation = dict(attributes)
        elif depth == 2 and tag == "DefaultExperiment":
            self.times = {k: self._float(v, k) for k, v in attributes.items() if k in _TIMES}
        elif depth in (3, 4) and self._path[1] == "ModelVariables":
            (self._begin_variable if depth == 3 else self._in_variable)(tag, attributes)
        elif depth in (3, 4) and self._path[1] in ("TypeDefinitions", "UnitDefinitions"):
            self._name = attributes.get("name", "") if depth == 3 else self._name
            if self._path[1] == "TypeDefinitions":
                self._take_type(attributes)
            elif tag == "BaseUnit":
                self._take_unit(attributes)

    def _begin_variable(self, tag: str, attributes: Mapping[str, str]) -> None:
        self._count(1)
        self._own, self._numbers, self._dimensions, self._aliases = dict(attributes), dict(attributes), [], []
        self._type = "" if self.version.inner else tag

    def _in_variable(self, tag: str, attributes: Mapping[str, str]) -> None:
        if self.version.inner and tag != "Annotations":
            self._type, self._numbers = self.version.inner.get(tag, tag), dict(attributes)
        elif tag == "Dimension":
            self._dimensions.append(dict(attributes))
        elif tag == "Alias":
            self._count(1)
            self._aliases.append(dict(attributes))

    def _take_type(self, attributes: Mapping[str, str]) -> None:
        """A declared type says of its variables what they do not say themselves."""
        limits.within(self._about(), len(self._types), limits.VARIABLES, "declared types")
        told = {k: v for k, v in attributes.items() if k in ("unit", "nominal")}
        self._types.setdefault(self._name, {}).update(told)

    def _take_unit(self, attributes: Mapping[str, str]) -> None:
        """A unit of the variables; one with an offset, or a factor of 0, is none that a factor converts."""
        limits.within(self._about(), len(self.units), limits.VARIABLES, "units")
        exponents = tuple(self._int(attributes.get(b, "0"), self._name) for b in BASE)
        factor = self._float(attributes.get("factor", "1"), self._name)
        if not self._float(attributes.get("offset", "0"), self._name) and isfinite(factor) and factor:
            self.units[plain(self._name)] = PhysicalUnit(plain(self._name), factor, exponents)

    def end(self, tag: str) -> None:
        if len(self._path) == 3 and self._path[1] == "ModelVariables":
            declared = self._types.get(self._numbers.get("declaredType", ""), {})
            for alias in ({}, *self._aliases):
                own, numbers = (declared | told | alias for told in (self._own, self._numbers))
                self._variable(self._type, own, numbers, self._dimensions)
        elif len(self._path) == 2 and tag == "ModelVariables":
            for type_, own, dimensions in self._waiting:
                self._array(type_, own, dimensions)
        self._path.pop()

    def _take_root(self, tag: str, attributes: dict[str, str]) -> None:
        number = attributes.get("fmiVersion", "")
        version = written_by(number)
        if version is None:
            raise FMUError(f"{self._about()}: FMI version '{plain(number, 50)}'; this reads {' and '.join(VERSIONS)}")
        self.version, self.root = version, attributes

    # -- variables ------------------------------------------------------------------------------------------

    def _variable(self, type_: str, own: dict[str, str], numbers: dict[str, str], dimensions: list[Any]) -> None:
        name = own.get("name", "")
        limits.within(f"{self._about()}: variable '{plain(name, 50)}'", len(name), limits.NAME, "characters in a name")
        if type_ not in self.version.types:
            self._leave_out(type_ or "untyped", name)
        elif "clocks" in own:
            self._leave_out(f"clocked {type_}", name)
        elif dimensions and all("start" in d for d in dimensions):
            self._array(type_, own, dimensions)
        elif dimensions:  # their size may be the start of a variable that comes later
            self._waiting.append((type_, own, dimensions))
        else:
            scalar = self._scalar(type_, own, numbers, name, numbers.get("start"))
            if type_ == "UInt64" and scalar.start is not None:
                self._sizes[scalar.reference] = int(scalar.start)
            self._add(scalar)

    def _array(self, type_: str, own: dict[str, str], dimensions: list[dict[str, str]]) -> None:
        """Its entries, called name[1], name[1,2], in the order of their values."""
        name, shape = own.get("name", ""), []
        for d in dimensions:
            size = self._size(d, name)
            if size is None:
                return self._leave_out(f"{type_} array of unknown size", name)
            shape.append(size)
        n = 1
        for size in shape:
            n *= max(size, 0)
            limits.within(self._about(), self._counted + n, limits.VARIABLES, "variables")
        self._count(n - 1)
        starts = own.get("start", "").split()
        if len(starts) not in (0, n):
            raise self._damaged(name, f"{len(starts)} start values for {n} entries")
        for entry, place in enumerate(product(*(range(1, size + 1) for size in shape))):
            index = ",".join(str(i) for i in place)
            start = starts[entry] if starts else None
            self._add(self._scalar(type_, own, own, f"{name}[{index}]", start, entry, n))
        return None

    def _size(self, dimension: dict[str, str], name: str) -> int | None:
        """Given as a number, or as the start of a variable."""
        if "start" in dimension:
            return self._int(dimension["start"], name)
        return self._sizes.get(self._int(dimension.get("valueReference", "-1"), name))

    def _add(self, scalar: Scalar) -> None:
        if scalar.name in self.variables:
            raise self._damaged(scalar.name, "there are two of that name")
        self.variables[scalar.name] = scalar

    def _count(self, more: int) -> None:
        self._counted += more
        if self._counted > limits.VARIABLES:  # most need no second look
            limits.within(self._about(), self._counted, limits.VARIABLES, "variables")

    def _scalar(
        self, type_: str, own: dict[str, str], numbers: dict[str, str], name: str, start: str | None, entry: int = 0,
        size: int = 0,
    ) -> Scalar:  # fmt: skip
        return Scalar(
            name=plain(name),
            reference=self._int(own.get("valueReference", "0"), name),
            causality=self._once(own.get("causality", "local")),
            start=None if start is None else self._float(start, name),
            unit=self._once(plain(numbers.get("unit", "1"))),
            nominal=self._float(numbers.get("nominal", "1"), name),
            description=self._once(plain(own.get("description", ""))),
            type=self._once(type_),
            entry=entry,
            size=size,
            variability=self._once(own.get("variability", "")),
            has_unit=bool(numbers.get("unit")),
        )

    def _leave_out(self, kind: str, name: str) -> None:
        self.left_out.setdefault(plain(kind, 50), OmittedVariables()).add(plain(name, 100))
        limits.within(self._about(), len(self.left_out), 100, "types of variables")

    # -- text -----------------------------------------------------------------------------------------------

    def _once(self, text: str) -> str:
        return self._shared.setdefault(text, text)

    def _about(self) -> str:
        return f"{self.file}/modelDescription.xml"

    def _damaged(self, name: str, what: object) -> FMUError:
        return FMUError(f"{self._about()}: variable '{plain(name, 100)}': {what}; the unit is damaged, export it again")

    def _float(self, text: str, name: str) -> float:
        try:
            return float({"true": "1", "false": "0"}.get(text, text))
        except ValueError as error:
            raise self._damaged(name, plain(str(error), 200)) from None

    def _int(self, text: str, name: str) -> int:
        try:
            return int(text)
        except ValueError as error:
            raise self._damaged(name, plain(str(error), 200)) from None


def read_interface(stream: IO[bytes], manifest: bytes | None, name: str) -> UnitInterface:
    """The interface of a unit from its documents; `name` is for messages."""
    about = ModelDescription(name)
    read(stream, f"{name}/modelDescription.xml", about)
    if about.cosimulation is None:
        raise FMUError(f"{name}: the unit has no Co-Simulation interface; export it for Co-Simulation")
    version, told = about.version, about.cosimulation
    own = {} if manifest is None else read_manifest(parse(manifest, f"{name}/manifest"))
    return UnitInterface(
        version=version.number,
        name=plain(about.root.get("modelName", name), 200),
        identifier=told.get("modelIdentifier", ""),
        token=about.root.get(version.token, ""),
        variables=about.variables,
        saves=told.get(version.saves) in TRUE,
        serialises=told.get(version.serialises) in TRUE,
        derivatives=told.get(version.derives) in TRUE,
        one_step=told.get("canHandleVariableCommunicationStepSize") in FALSE,
        one_instance=told.get("canBeInstantiatedOnlyOncePerProcess") in TRUE,
        tool=told.get("needsExecutionTool") in TRUE,
        event_mode=told.get("hasEventMode") in TRUE,
        early_return=told.get("mightReturnEarlyFromDoStep") in TRUE,
        clocks=sum(o.count for kind, o in about.left_out.items() if kind == "Clock"),
        start=about.times.get("startTime", 0.0),
        stop=about.times.get("stopTime"),
        step=about.times.get("stepSize"),
        description=plain(about.root.get("description", "")),
        units=about.units,
        left_out="; ".join(f"{kind}: {o.count} ({o})" for kind, o in about.left_out.items()),
        **own,
    )
