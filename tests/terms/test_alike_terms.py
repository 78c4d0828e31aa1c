"""Terms that are made once per form are those that are made one by one."""

import casadi as ca
import numpy as np
import pytest

from phfmu import build_model, default_scheme
from phfmu.components.electrical.machines.synchronous_machine import synchronous_machine
from phfmu.components.mechanical.chain import chain
from phfmu.components.mechanical.four_particle import four_particle
from phfmu.components.mechanical.mechanisms.bricard import bricard
from phfmu.components.mechanical.net import net
from phfmu.components.scenes.electrical.two_machine import two_machine
from phfmu.discretise import model as discretised
from phfmu.terms.canonical import Locator

PLANS = {
    "chain": lambda: chain(6, damping=1.0, bending=2.0, port=True),
    "net": lambda: net(3),
    "four_particle": four_particle,
    "bricard": bricard,
    "synchronous_machine": synchronous_machine,
    "two_machine": lambda: two_machine().system.compose(),
}


class Forgetful(dict):
    """Keeps nothing."""

    def __setitem__(self, key, value):
        pass


def tables(plan):
    """All arrays of a plan and the kernels of its groups, by name."""
    out = {name: v for name, v in vars(plan).items() if isinstance(v, np.ndarray)}
    for what in ("matrix", "derivative"):
        out |= {f"{what}.{name}": v for name, v in vars(getattr(plan, what)).items()}
    for i, g in enumerate(plan.groups):
        out |= {f"group {i}.{name}": v for name, v in vars(g).items() if isinstance(v, np.ndarray)}
    return out, [g.kernel.name for g in plan.groups]


@pytest.mark.parametrize("order", [2, 6])
@pytest.mark.parametrize("name", PLANS)
def test_plans_of_terms_by_form_are_those_of_terms_one_by_one(name, order, monkeypatch):
    declaration = PLANS[name]()
    scheme = default_scheme(declaration, order)
    by_form = build_model(declaration, scheme)
    made = Locator.__init__

    def forgets(self, *given):
        made(self, *given)
        self.known = Forgetful()

    monkeypatch.setattr(Locator, "__init__", forgets)
    discretised._terms.cache_clear()
    discretised._instant.cache_clear()
    one_by_one = discretised._discretised(declaration, scheme, False)
    for a, b in ((by_form.step, one_by_one.step), (by_form.instant, one_by_one.instant)):
        (arrays, kernels), (expected, names) = tables(a), tables(b)
        assert kernels == names and arrays.keys() == expected.keys()
        for key, value in arrays.items():
            np.testing.assert_array_equal(value, expected[key], err_msg=key)


def test_forms_tell_constants_and_the_places_of_symbols_apart():
    from phfmu.terms.canonical import read

    declaration = chain(2)
    locator = Locator(declaration, [])
    q = ca.vertsplit(declaration.states[0].sx)

    def form(expr):
        return read([expr], locator, "test").form

    assert form(2 * q[0] + q[1]) == form(2 * q[3] + q[2])
    assert form(2 * q[0] + q[1]) != form(3 * q[0] + q[1])
    assert form(q[0] * ca.sin(q[1])) != form(q[0] * ca.sin(q[0]))
    assert form(q[0] * 1e-300) != form(q[0] * 1.0000000000000002e-300)
    assert form(declaration.parameters[0].sx[0]) != form(q[0])
